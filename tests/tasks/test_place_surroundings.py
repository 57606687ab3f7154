from __future__ import annotations

import numpy as np

from cellwright.cell.bodies import BASE, WORLD, Body, Box, Sphere
from cellwright.cell.transforms import apply, pose
from schemas.artefact import digest
from schemas.part import Surroundings
from schemas.poses import Pose
from tasks.place_surroundings import SurroundingsParams, place_surroundings
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.test_simulate_scan import T_WORLD_BASE, cell_model

T_WORLD_PART = pose(np.array([0.5, 0.1, 0.3]), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
TABLE = Body("table", Box((1.0, 2.0, 0.2)), WORLD, np.eye(4))
PLINTH = Body("plinth", Box((0.1, 0.1, 0.1)), BASE, np.eye(4))
LINK = Body("link", Sphere(0.1), 1, np.eye(4))


def placed(*bodies: Body, T_world_part: np.ndarray = T_WORLD_PART) -> Surroundings:
    found = place_surroundings(cell_model(*bodies), params=SurroundingsParams(T_world_part=Pose.of(T_world_part)))
    assert isinstance(found, Surroundings)
    return found


def test_standing_bodies_are_seen_from_the_part_and_moving_ones_are_left_out() -> None:
    found = placed(TABLE, LINK)
    assert len(found.faces) == 12
    back = apply(T_WORLD_PART, found.vertices_m)
    np.testing.assert_allclose(back.max(axis=0), [0.5, 1.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(back.min(axis=0), [-0.5, -1.0, -0.1], atol=1e-12)


def test_what_is_fixed_to_the_base_stands_where_the_base_does() -> None:
    back = apply(T_WORLD_PART, placed(PLINTH).vertices_m)
    np.testing.assert_allclose(back.mean(axis=0), T_WORLD_BASE[:3, 3], atol=1e-12)


def test_faces_of_later_bodies_point_at_their_own_vertices() -> None:
    both = placed(TABLE, PLINTH)
    assert len(both.faces) == 24 and both.faces[12:].min() == 8
    assert both.faces.max() == len(both.vertices_m) - 1


def test_an_empty_cell_has_no_surroundings() -> None:
    assert len(placed(LINK).faces) == 0


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(place_surroundings, rounded(placed(TABLE, PLINTH, LINK)))


def test_nothing_else_of_the_cell_changes_them() -> None:
    assert digest(placed(TABLE, LINK)) == digest(placed(TABLE))
    moved = T_WORLD_PART.copy()
    moved[0, 3] += 0.1
    assert digest(placed(TABLE, T_world_part=moved)) != digest(placed(TABLE))
