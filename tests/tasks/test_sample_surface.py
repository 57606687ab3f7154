import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from cellwright.cell.bodies import Mesh
from cellwright.cell.parametric_parts import grooved_cylinder, stl_bytes
from cellwright.errors import InvalidInputError
from schemas.part import PartMesh, SurfaceSamples
from schemas.sources import SourceFile
from tasks.preprocess_mesh import MeshParams, preprocess_mesh
from tasks.sample_surface import SurfaceParams, sample_surface
from tests.tasks.goldens import check_golden


def part(mesh: Mesh, up: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> PartMesh:
    source = SourceFile(name="part.stl", content=stl_bytes(mesh))
    found: PartMesh = preprocess_mesh(source, params=MeshParams(up_part=up))
    return found


CYLINDER = part(grooved_cylinder())


def samples(mesh: PartMesh, **params: object) -> SurfaceSamples:
    found: SurfaceSamples = sample_surface(mesh, params=SurfaceParams.model_validate(params))
    return found


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(["random", "blue-noise"]), st.floats(1.0, 20_000), st.integers(0, 2**40))
def test_samples_lie_on_faces_to_measure_at_the_density_asked_for(method: str, density: float, seed: int) -> None:
    found = samples(CYLINDER, method=method, density_per_m2=density, seed=seed)
    area = CYLINDER.areas_m2[CYLINDER.to_measure].sum()
    assert len(found.points_m) == max(1, round(density * area))
    assert found.area_m2 == pytest.approx(area)
    assert CYLINDER.to_measure[found.face].all()
    assert np.array_equal(found.normals, CYLINDER.normals[found.face])
    on_plane = np.einsum("ij,ij->i", found.points_m - CYLINDER.vertices_m[CYLINDER.faces[found.face, 0]], found.normals)
    assert np.abs(on_plane).max() < 1e-12


def test_a_small_surface_gets_the_fewest_samples_and_a_large_one_its_density() -> None:
    density = 100 / CYLINDER.areas_m2[CYLINDER.to_measure].sum()
    for at_least, count in ((1, 100), (100, 100), (250, 250)):
        found = samples(CYLINDER, density_per_m2=density, at_least=at_least)
        assert len(found.points_m) == count
        assert len(np.unique(np.round(found.points_m, 9), axis=0)) == count


def test_the_papers_densities_give_the_papers_counts() -> None:
    for per_mm2, expected in ((0.001, 91), (0.005, 455), (0.01, 910)):
        assert len(samples(CYLINDER, density_per_m2=per_mm2 * 1e6).points_m) == expected


def test_the_verification_cloud_is_independent_of_the_samples() -> None:
    one, other = (samples(CYLINDER, density_per_m2=5e3, seed=seed) for seed in (0, 1))
    assert not np.isin(one.points_m[:, 0], other.points_m[:, 0]).any()


def test_both_sides_of_a_two_sided_sheet_are_sampled() -> None:
    upright = Mesh(
        np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0.0]]), np.array([[0, 1, 2], [0, 3, 2]], np.int32)
    )
    mesh = part(upright, up=(0.0, 1.0, 0.0))
    assert mesh.two_sided
    found = samples(mesh, density_per_m2=1e5)
    assert len(found.points_m) == 2000
    assert np.count_nonzero(found.normals[:, 2] > 0) == pytest.approx(1000, abs=40)
    assert found.face.max() < 2


def test_a_density_that_asks_for_too_many_samples_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"asks for .* samples but at most .*: lower density_per_m2"):
        samples(CYLINDER, density_per_m2=1e12)


def test_params_that_make_no_sense_are_refused() -> None:
    for wrong in ({"density_per_m2": 0}, {"density_per_m2": math.inf}, {"method": "poisson"}, {"seed": -1}):
        with pytest.raises(ValidationError):
            SurfaceParams.model_validate(wrong)


def test_the_result_is_the_one_of_this_version() -> None:
    found = [samples(CYLINDER, method=method, density_per_m2=2000.0, seed=7) for method in ("blue-noise", "random")]
    check_golden(sample_surface, *found)
