from __future__ import annotations

from dataclasses import replace
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest

from cellwright.causes import Cause
from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.parallel_axes import parallel_axes_geometry
from cellwright.cell.scene import Scene
from cellwright.cell.transforms import inverse, pose, quaternion_from_rotation
from cellwright.errors import InvalidInputError
from schemas.artefact import digest
from schemas.cell_objects import build_cell, packed_bodies
from schemas.sweep_params import SweepParams
from schemas.views import Measurability, Reachability, Viewpoints
from tasks.follow_sweeps import follow_sweeps
from tests.cellwright.solvers import scanning_cell
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.scanning_artefacts import PART_POSE, T_WORLD_PART, cell_model, part_mesh

ANGLES = [(angle, tilt) for angle in np.linspace(-3.0, 3.0, 9) for tilt in (0.3, 0.8)]
PARAMS = SweepParams(T_world_part=PART_POSE)


@cache
def viewpoints() -> Viewpoints:
    T = np.stack([inverse(T_WORLD_PART) @ scanning_cell.sweep_pose(*angle) for angle in ANGLES])
    n = len(T)
    zero = np.zeros(n)
    return Viewpoints(
        sample=np.arange(n, dtype=np.int32),
        position_m=T[:, :3, 3],
        quaternion=quaternion_from_rotation(T[:, :3, :3]),
        delta_rot_rad=zero,
        theta_tilt_rad=zero,
        psi_tilt_rad=zero,
        standoff_m=np.full(n, scanning_cell.STANDOFF),
    )


def measured(*, half_m: float = 0.03, idle: int = 0) -> Measurability:
    """Each view measures its own sample and one without a view at both ends of its interval; the last are idle."""
    n = len(ANGLES)
    view = np.arange(n - idle, dtype=np.int32)
    travel = np.where(np.arange(n) < n - idle, half_m, np.nan)
    return Measurability(
        view=np.repeat(view, 2),
        sample=np.column_stack([view, np.full(n - idle, n)]).ravel().astype(np.int32),
        uncertainty_m=np.full(2 * (n - idle), 5e-5, np.float32),
        start_m=-travel,
        end_m=travel,
        cause=np.zeros(n + 1, np.int8),
    )


@cache
def reached() -> Reachability:
    return follow_sweeps(cell_model(), part_mesh(), viewpoints(), measured(), params=PARAMS)


def test_views_get_pieces_or_causes():
    found = reached()
    n = len(ANGLES)
    has = np.isin(np.arange(n), found.view)
    assert has.sum() > 2
    assert ((found.outcome == 0) == has).all()
    assert (found.end_m - found.start_m >= 0.05 - 1e-9).all()
    assert (found.start_m >= -0.06 - 1e-9).all() and (found.end_m <= 0.06 + 1e-9).all()
    assert ((found.blocked_by >= 0) == (found.outcome == Cause.COLLISION)).all()
    assert found.body[-1] == "part"


def test_pieces_begin_free_in_limits_and_at_the_pose_of_their_travel():
    found, built = reached(), build_cell(cell_model(), part_mesh(), T_WORLD_PART)
    scene = Scene(built, PARAMS.clearance_m)
    for row, q in enumerate(found.q_start_rad):
        assert not scene.collides(q)
        assert (q >= built.robot.chain.lower).all() and (q <= built.robot.chain.upper).all()
        along = pose(np.array([found.start_m[row], 0.0, 0.0]), np.eye(3))
        T = built.T_world_base @ built.robot.flange_pose(q) @ built.T_flange_scanner
        assert np.allclose(T, scanning_cell.sweep_pose(*ANGLES[found.view[row]]) @ along, atol=1e-6)


def test_views_that_measure_nothing_are_not_followed():
    found = follow_sweeps(cell_model(), part_mesh(), viewpoints(), measured(idle=9), params=PARAMS)
    assert found.view.max(initial=-1) < len(ANGLES) - 9
    assert (found.outcome[-9:] == Cause.NONE).all()


def test_the_same_recipe_gives_the_same_content():
    again = follow_sweeps(cell_model(), part_mesh(), viewpoints(), measured(), params=PARAMS)
    assert digest(again) == digest(reached())


def test_progress_rises_to_one():
    shares: list[float] = []
    follow_sweeps(cell_model(), part_mesh(), viewpoints(), measured(), params=PARAMS, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_bodies_that_stand_still_may_touch():
    model = cell_model()
    bodies = (
        *scanning_cell.cell_without_part().bodies,
        Body("plinth", Box((0.2, 0.2, 0.1)), WORLD, pose(np.array([0, 0, -0.03]), np.eye(3))),
    )
    found = follow_sweeps(replace(model, **packed_bodies(bodies)), part_mesh(), viewpoints(), measured(), params=PARAMS)
    assert (found.outcome == Cause.NONE).sum() == (reached().outcome == Cause.NONE).sum() > 0


def test_artefacts_that_do_not_belong_together_are_refused():
    few = Measurability(
        view=np.array([0], np.int32),
        sample=np.array([0], np.int32),
        uncertainty_m=np.array([5e-5], np.float32),
        start_m=np.array([0.0]),
        end_m=np.array([0.0]),
        cause=np.zeros(1, np.int8),
    )
    with pytest.raises(InvalidInputError, match=f"measurability has 1 views but there are {len(ANGLES)} viewpoints"):
        follow_sweeps(cell_model(), part_mesh(), viewpoints(), few, params=PARAMS)


def calibrated(urdf: str) -> str:
    """The arm with axes that are off by what calibration finds: no family knows it, so that it is eliminated."""
    tree = ElementTree.fromstring(urdf)
    for number, joint in enumerate(tree.iter("joint")):
        origin = joint.find("origin")
        if origin is not None and joint.get("type") == "revolute":
            turn = np.array(origin.get("rpy", "0 0 0").split(), float) + 1e-3 * np.array([1, -1, 1]) * (-1) ** number
            origin.set("rpy", " ".join(repr(angle) for angle in turn.tolist()))
    return ElementTree.tostring(tree, encoding="unicode")


@cache
def reached_by_a_calibrated_arm() -> Reachability:
    model = replace(cell_model(), urdf=calibrated(cell_model().urdf))
    assert parallel_axes_geometry(build_cell(model).robot.chain) is None
    return follow_sweeps(model, part_mesh(), viewpoints(), measured(idle=len(ANGLES) - 4), params=PARAMS)


def test_the_result_is_the_one_of_this_version():
    assert (np.unique(reached().outcome) == [Cause.NONE, Cause.COLLISION]).all()
    assert len(reached_by_a_calibrated_arm().view) > 1
    check_golden(follow_sweeps, rounded(reached(), 6), rounded(reached_by_a_calibrated_arm(), 4))
