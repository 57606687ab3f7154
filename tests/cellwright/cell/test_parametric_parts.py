from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.mesh_repair import RepairedMesh, repair_mesh
from cellwright.cell.parametric_parts import (
    box,
    floor_panel,
    grooved_cylinder,
    panel_height,
    plate_with_pocket,
    prism,
    revolve,
    stl_bytes,
)
from cellwright.cell.part import read_mesh
from cellwright.errors import InvalidInputError

EXAMPLES = Path(__file__).parents[3] / "examples"
UP = np.array([0.0, 0.0, 1.0])


def sound(mesh: Mesh) -> RepairedMesh:
    found = repair_mesh(mesh.vertices, mesh.faces, UP, 1e-9)
    assert found.watertight and len(found.findings) == 1, found.findings
    assert np.array_equal(found.faces, mesh.faces)  # outward as built
    return found


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_the_shipped_part_is_what_the_code_builds() -> None:
    assert (EXAMPLES / "grooved_cylinder.stl").read_bytes() == stl_bytes(grooved_cylinder())


def test_the_grooved_cylinder_has_the_surface_of_the_paper() -> None:
    mesh = sound(grooved_cylinder())
    measured = mesh.areas[mesh.normals @ -UP < np.cos(np.radians(20))].sum()
    assert mesh.areas.sum() == pytest.approx(0.1, abs=0.003)
    # the paper samples 24,570 viewpoints at 0.01 /mm^2 with 27 tilts: 910 samples
    assert round(measured * 1e6 * 0.01) * 27 == 24_570


def test_its_flanks_are_inclined_differently() -> None:
    mesh = sound(grooved_cylinder())
    slopes = np.unique(np.degrees(np.arcsin(mesh.normals[:, 2])).round(2))
    assert len(slopes) == 5  # bottom, upper flank, side, lower flank, top
    assert slopes[1] == pytest.approx(-np.degrees(np.arctan(20 / 30)), abs=0.05)
    assert slopes[3] == pytest.approx(np.degrees(np.arctan(20 / 10)), abs=0.05)


def test_volumes_are_exact() -> None:
    assert volume(box((0.1, 0.2, 0.3))) == pytest.approx(0.006)
    assert volume(plate_with_pocket()) == pytest.approx(0.12 * 0.08 * 0.02 - 0.06 * 0.04 * 0.012)
    corners = np.array([[0, 0], [1, 0], [0.5, 1.0]])
    assert volume(prism(corners, 2.0)) == pytest.approx(1.0)
    many = revolve(np.array([[1.0, 0.0], [1.0, 1.0]]), 2000)
    assert volume(many) == pytest.approx(np.pi, rel=1e-5)


@settings(deadline=None)
@given(st.integers(3, 40), st.lists(st.tuples(st.floats(0.01, 1), st.floats(0.01, 1)), min_size=2, max_size=6))
def test_turned_profiles_are_watertight(n_segments: int, steps: list[tuple[float, float]]) -> None:
    radii, rises = np.array(steps).T
    profile: FloatArray = np.column_stack([radii, np.cumsum(rises)])
    sound(revolve(profile, n_segments))


def test_stl_reads_back_to_single_precision() -> None:
    mesh = plate_with_pocket()
    again = read_mesh("part.stl", stl_bytes(mesh))
    assert np.allclose(again.vertices[again.faces] * 1e-3, mesh.vertices[mesh.faces], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("wrong", [{"groove_depth": 0.1}, {"height": 0.1}, {"groove_bottom": 0.0}])
def test_a_groove_that_does_not_fit_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError, match="does not fit into a cylinder"):
        grooved_cylinder(**wrong)  # type: ignore[arg-type]


def test_a_pocket_or_profile_that_makes_no_solid_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="does not fit into a plate"):
        plate_with_pocket(pocket=(0.2, 0.01, 0.01))
    with pytest.raises(InvalidInputError, match="give positive radii"):
        revolve(np.array([[0.0, 0.0], [1.0, 1.0]]), 8)


def test_the_floor_panel_is_a_closed_sheet_of_even_upright_thickness():
    mesh = floor_panel(thickness=0.01)
    corners = mesh.vertices[mesh.faces]
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge) for edge in edges[:, ::-1].tolist()}
    assert len(np.unique(edges, axis=0)) == len(edges)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert volume == pytest.approx(1.4 * 2.1 * 0.01, rel=1e-6)
    half = len(mesh.vertices) // 2
    assert np.allclose(mesh.vertices[:half, 2], panel_height(mesh.vertices[:half, 0], mesh.vertices[:half, 1]))


def test_the_shipped_floor_panel_is_the_one_that_is_built_here():
    assert (EXAMPLES / "floor_panel.stl").read_bytes() == stl_bytes(floor_panel())


def test_a_panel_without_thickness_is_refused():
    with pytest.raises(InvalidInputError, match="thickness"):
        floor_panel(thickness=0.0)
