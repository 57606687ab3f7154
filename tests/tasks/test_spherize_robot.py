"""A robot of any serial kind is covered link by link, and its hulls come onto the arm's links."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.cell.built_in_robots import built_in_arm, built_in_digest
from cellwright.errors import InvalidInputError
from schemas.layout import RobotHull
from schemas.layout_objects import link_spheres
from schemas.sources import SourceFile
from tasks.spherize_robot import RobotHullParams, spherize_robot
from tests.tasks.goldens import check_golden, rounded

BARE = b"<robot name='bare'><link name='a'/><link name='b'/><joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint></robot>"  # noqa: E501


@cache
def hull() -> RobotHull:
    params = RobotHullParams(robot="pr_robot", robot_sha256=built_in_digest("pr_robot"), n_spheres=2, n_starts=1)
    found: RobotHull = spherize_robot((), params=params)
    return found


def test_every_link_is_proven_to_lie_in_its_spheres() -> None:
    found = hull()
    assert found.surface_covered.all() and (found.coverage == 1.0).all()
    assert found.n_spheres.sum() == len(found.radius_m)
    assert b"<sphere" in found.urdf and b"<disable_collisions" in found.srdf


def test_progress_rises_to_one() -> None:
    shares: list[float] = []
    params = RobotHullParams(robot="pr_robot", robot_sha256=built_in_digest("pr_robot"), n_spheres=2, n_starts=1)
    spherize_robot((), params=params, progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0 and len(shares) > 4


def test_hulls_sit_on_the_links_of_the_arm() -> None:
    arm, found = built_in_arm("pr_robot"), hull()
    spheres = link_spheres(arm, found, self_collision=True)
    assert len(spheres) == len(found.radius_m)
    assert set(spheres.link.tolist()) <= set(range(arm.n_joints + 1))
    n_pairs = sum(int(found.n_spheres[one] * found.n_spheres[other]) for one, other in found.checked_pair.tolist())
    assert len(spheres.self_pairs) == n_pairs
    assert not len(link_spheres(arm, found, self_collision=False).self_pairs)


def test_a_robot_without_shapes_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"bare\.urdf has no collision geometry to cover"):
        spherize_robot((SourceFile(name="bare.urdf", content=BARE),), params=RobotHullParams(robot="bare.urdf"))


def test_the_result_is_the_one_of_this_version() -> None:
    found = rounded(hull(), 4)
    # files hold more digits than are alike everywhere
    check_golden(spherize_robot, rounded(found, 4, urdf=b"", touching_share=np.zeros_like(found.touching_share)))
