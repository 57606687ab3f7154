"""A robot of spheres: the URDF reads back exactly, holds every link, and its ignored pairs are those of the hulls."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Sphere
from cellwright.cell.enclosing_mesh import enclosing_mesh
from cellwright.cell.ignored_pairs import Reason
from cellwright.cell.parametric_parts import box
from cellwright.cell.robot import Robot
from cellwright.cell.sphere_pairs import hull_pairs
from cellwright.cell.spherized_urdf import link_shapes, sampled_link_poses, spherized_urdf
from cellwright.cell.transforms import apply
from cellwright.cell.urdf_geometry import collision_bodies
from cellwright.cell.urdf_tree import parse_urdf
from cellwright.errors import InvalidInputError
from cellwright.solvers.spheres.fitting import FitSettings
from cellwright.solvers.spheres.metrics import union_gaps
from cellwright.solvers.spheres.robots import SpherizedRobot, fit_many, shared_numbers, spherize_robot

QUICK = FitSettings(n_starts=1, n_points=1000)
ARM = """<?xml version="1.0"?>
<robot name="arm">
  <!-- kept -->
  <link name="base_link"><visual><geometry><box size="1 1 1"/></geometry></visual>
    <collision><geometry><cylinder radius="0.1" length="0.2"/></geometry></collision></link>
  <link name="upper"><inertial><mass value="2"/></inertial>
    <collision><origin xyz="0 0 0.2" rpy="0.3 0 0"/><geometry><box size="0.08 0.1 0.4"/></geometry></collision>
    <collision><origin xyz="0 0 0.4"/><geometry><capsule radius="0.05" length="0.1"/></geometry></collision></link>
  <link name="fore"><collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.03"/></geometry></collision>
    <collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <link name="bare"/>
  <link name="tip"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
  <joint name="a" type="revolute"><parent link="base_link"/><child link="upper"/><origin xyz="0 0 0.15"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.5"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="0.2" velocity="1" effort="1"/></joint>
  <joint name="c" type="fixed"><parent link="fore"/><child link="bare"/><origin xyz="0.25 0 0"/></joint>
  <joint name="d" type="fixed"><parent link="bare"/><child link="tip"/></joint>
</robot>"""


def no_mesh(name: str) -> bytes:
    raise InvalidInputError(f"no mesh {name}")


def spherized(n_threads: int | None = None) -> SpherizedRobot:
    return spherize_robot(
        ARM, no_mesh, 6, generator=np.random.default_rng(0), settings=QUICK, n_threads=n_threads
    )  # fmt: skip


ROBOT = spherized()


def test_the_urdf_reads_back_as_the_same_spheres() -> None:
    read = Robot.from_urdf(ROBOT.urdf, flange_link="tip")
    bodies = collision_bodies(read, no_mesh)
    assert all(isinstance(body.shape, Sphere) for body in bodies)
    shapes = link_shapes(parse_urdf(ROBOT.urdf), no_mesh)
    for hull in ROBOT.links:
        found = shapes[hull.link]
        assert [shape.radius for shape, _ in found if isinstance(shape, Sphere)] == hull.radii.tolist()
        assert [T[:3, 3].tolist() for _, T in found] == hull.centres.tolist()
    assert [hull.link for hull in ROBOT.links] == ["base_link", "upper", "fore", "tip"]


def test_everything_but_the_collision_geometry_stays() -> None:
    before, after = ElementTree.fromstring(ARM), ElementTree.fromstring(ROBOT.urdf)
    for robot in (before, after):
        for link in robot.findall("link"):
            for collision in link.findall("collision"):
                link.remove(collision)

    def content(robot: ElementTree.Element) -> list[object]:
        return [(element.tag, dict(element.attrib)) for element in robot.iter()]

    assert content(before) == content(after)
    assert "<!-- kept -->" in ROBOT.urdf


def test_every_shape_of_every_link_is_held() -> None:
    rng = np.random.default_rng(1)
    shapes = link_shapes(parse_urdf(ARM), no_mesh)
    for hull in ROBOT.links:
        for shape, T in shapes[hull.link]:
            if hull.fit is not None:
                mesh = enclosing_mesh(shape)
                corners = mesh.vertices[mesh.faces]
                points = np.einsum("pk,tkc->tpc", rng.dirichlet(np.ones(3), 20), corners).reshape(-1, 3)
                assert union_gaps(apply(T, points), hull.centres, hull.radii).max() <= 0.0
                assert hull.fit.interior == "covered"
    fore = ROBOT.links[2]
    assert fore.fit is None
    assert fore.radii.tolist() == [0.03, 0.02]


def test_pairs_that_need_no_check_are_listed_and_the_others_are_not() -> None:
    assert [(a, b, reason) for a, b, reason in ROBOT.ignored()] == [
        ("base_link", "upper", Reason.NEIGHBOURS),
        ("base_link", "fore", Reason.NEVER_TOUCHING),
        ("base_link", "tip", Reason.NEVER_TOUCHING),
        ("upper", "fore", Reason.NEIGHBOURS),
        ("upper", "tip", Reason.NEIGHBOURS),
        ("fore", "tip", Reason.SAME_PARENT),
    ]
    listed = ElementTree.fromstring(ROBOT.srdf).findall("disable_collisions")
    assert [element.get("reason") for element in listed] == ["Adjacent", "Never", "Never"] + ["Adjacent"] * 3
    assert ElementTree.fromstring(ROBOT.srdf).get("name") == "arm"


def balls(*rows: tuple[float, float, float, float]) -> tuple[FloatArray, FloatArray]:
    return np.array(rows)[:, :3], np.array(rows)[:, 3]


def test_hulls_are_sorted_by_what_they_do_in_all_configurations() -> None:
    n = 50
    still = np.tile(np.eye(4), (n, 1, 1))
    sliding = still.copy()
    sliding[:, 0, 3] = np.linspace(0.0, 1.0, n)
    big, small, far = balls((0, 0, 0, 0.5)), balls((0, 0, 0, 0.1), (0.2, 0, 0, 0.1)), balls((0, 9, 0, 0.1))
    found = hull_pairs(
        [big[0], small[0], far[0], small[0]],
        [big[1], small[1], far[1], small[1]],
        [0, 1, 2, 3],
        [still, still, sliding, sliding],
        [],
    )
    reasons = dict(zip(map(tuple, found.ignored.tolist()), found.reason.tolist()))
    assert reasons[0, 1] == Reason.ALWAYS_TOUCHING
    assert reasons[0, 2] == reasons[1, 2] == reasons[2, 3] == Reason.NEVER_TOUCHING
    assert found.checked.tolist() == [[0, 3], [1, 3]]
    assert found.touching[0] == pytest.approx(0.6, abs=0.03)
    assert found.touching[1] == pytest.approx(0.4, abs=0.03)


def test_sampled_poses_are_those_of_the_kinematics() -> None:
    tree, robot = parse_urdf(ARM), Robot.from_urdf(ARM, flange_link="tip")
    n = 20
    poses = sampled_link_poses(tree, n, np.random.default_rng(5))
    rng = np.random.default_rng(5)
    q = np.stack([rng.uniform(-3, 3, n), rng.uniform(-1, 0.2, n)], axis=1)
    for row in range(n):
        np.testing.assert_allclose(poses["tip"][row], robot.flange_pose(q[row]), atol=1e-12)


def test_a_flat_link_gets_spheres_of_a_compact_one() -> None:
    meshes = {"plate": box((0.3, 0.3, 0.02)), "cube": box((0.1, 0.1, 0.1)), "bar": box((0.3, 0.05, 0.05))}
    numbers = shared_numbers(meshes, [12] * 3, np.random.default_rng(0), QUICK)
    assert sum(numbers) == 36
    assert numbers[0] > 15
    assert min(numbers) >= 3
    even, shared = (fit_many(meshes, n, np.random.default_rng(0), QUICK) for n in ([12] * 3, numbers))
    worst = [max(fit.metrics.volume_ratio for fit in fits) for fits in (even, shared)]
    assert worst[1] < 0.9 * worst[0]


def test_shared_or_named_numbers_are_those_of_the_hulls() -> None:
    assert sum(len(hull.radii) for hull in ROBOT.links if hull.fit) == 18
    named = spherize_robot(
        ARM, no_mesh, {"base_link": 2, "upper": 5, "tip": 1}, generator=np.random.default_rng(0), settings=QUICK
    )
    assert [len(hull.radii) for hull in named.links] == [2, 5, 2, 1]
    even = spherize_robot(ARM, no_mesh, 3, generator=np.random.default_rng(0), settings=QUICK, share=False)
    assert [len(hull.radii) for hull in even.links] == [3, 3, 2, 3]


def test_threads_change_nothing() -> None:
    assert spherized(1).urdf == spherized(3).urdf == ROBOT.urdf
    assert spherized(1).srdf == ROBOT.srdf


def test_links_without_a_number_and_links_that_are_not_there_are_named() -> None:
    with pytest.raises(InvalidInputError, match="link upper, tip is given no number"):
        spherize_robot(ARM, no_mesh, {"base_link": 3}, generator=np.random.default_rng(0), settings=QUICK)
    with pytest.raises(InvalidInputError, match="has no link nothing"):
        spherized_urdf(ARM, {"nothing": balls((0, 0, 0, 1))})
    meshed = ARM.replace('<box size="0.02 0.02 0.02"/>', '<mesh filename="tip.stl"/>')
    with pytest.raises(InvalidInputError, match=r"link 'tip': no mesh tip\.stl"):
        spherize_robot(meshed, no_mesh, 3, generator=np.random.default_rng(0), settings=QUICK)
    with pytest.raises(InvalidInputError, match="base_link: 0 spheres are asked for"):
        spherize_robot(ARM, no_mesh, 0, generator=np.random.default_rng(0), settings=QUICK)
