"""Standing bodies are covered one by one, each proven to be held."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from schemas.body_params import BoxBody, CylinderBody, MeshBody
from schemas.sphere_hull import SphereHull
from tasks.cover_bodies import CoveredBody, CoverParams, cover_bodies
from tests.tasks.goldens import check_golden, rounded

PARAMS = CoverParams(
    bodies=(
        CoveredBody(body=BoxBody(name="box", size_m=(0.4, 0.2, 0.1)), n_spheres=2),
        CoveredBody(body=CylinderBody(name="post", radius_m=0.05, length_m=0.3), n_spheres=3),
    ),
    n_starts=1,
)


@cache
def hulls() -> SphereHull:
    found: SphereHull = cover_bodies((), params=PARAMS)
    return found


def test_every_point_of_a_body_lies_in_a_sphere() -> None:
    found = hulls()
    assert found.body == ("box", "post") and found.n_spheres.tolist() == [2, 3] and found.surface_covered.all()
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (2000, 3)) * (0.4, 0.2, 0.1)
    away = np.linalg.norm(points[:, None] - found.centre_m[:2], axis=2)
    assert (away <= found.radius_m[:2]).any(axis=1).all()


def test_a_mesh_that_is_not_there_is_named() -> None:
    body = MeshBody(name="housing", file="housing: a.stl")
    with pytest.raises(InvalidInputError, match=r"housing: mesh 'housing: a\.stl' is not among the given files"):
        cover_bodies((), params=CoverParams(bodies=(CoveredBody(body=body),)))


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(cover_bodies, rounded(hulls(), 4))
