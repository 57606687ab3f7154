"""The layout problems of `benchmarks.layout`: four small stations about a UR10e, free or among posts.

After Baumgaertner 2025, section 5.1, which states neither robot nor sizes: four small rectangular workstations in
position and rotation about z, with target poses centred above them. Chosen here: boxes of 0.3 x 0.2 x 0.1 m that move
on an annulus of 0.5 m to 0.9 m about the robot, up to 0.15 m high, and may not overlap; the end effector as a point.
"""

from __future__ import annotations

import numpy as np

from cellwright.cell.built_in_robots import built_in_robot
from cellwright.cell.harness import DesignJoint, Harness, X, Z, fixed
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import pose
from cellwright.solvers.layout.bodies import box_hull
from cellwright.solvers.layout.examples import DOWN
from cellwright.solvers.layout.problem import (
    Approach,
    LayoutProblem,
    RobotSpheres,
    Spheres,
    Station,
    end_effector_point,
)

BOX = (0.3, 0.2, 0.1)


def ring(around: tuple[float, float], out: tuple[float, float], height: tuple[float, float]) -> Harness:
    return Harness(
        (
            DesignJoint("around", True, Z, *around),
            DesignJoint("out", False, X, *out),
            DesignJoint("height", False, Z, *height),
            DesignJoint("turn", True, Z, -np.pi, np.pi),
        )
    )


def ur10e() -> SerialArm:
    return SerialArm.from_robot(built_in_robot("ur10e"))


def four_stations() -> LayoutProblem:
    """Sixteen design joints; hulls of two spheres; the tool's pose 0.2 m above each station's middle."""
    arm = ur10e()
    above = Approach(pose(np.array([[0.0, 0.0, 0.2]]), DOWN[None]))
    hull = box_hull(BOX, (2, 1, 1), np.zeros(3))
    harness = ring((-np.pi, np.pi), (0.5, 0.9), (0.0, 0.15))
    stations = tuple(Station(f"station {n}", harness, hull, (above,)) for n in range(1, 5))
    return LayoutProblem(arm, stations, robot_spheres=end_effector_point(arm))


def link_spheres(arm: SerialArm, T_flange_tool: np.ndarray) -> RobotSpheres:
    """Spheres along the lines from joint to joint from the second link on: three on long links, one on short ones."""
    links, centres, radii = [], [], []
    ends = [*arm.T_parent_joint[1:, :3, 3], (arm.T_last_flange @ T_flange_tool)[:3, 3]]
    for link, end in list(enumerate(ends, 1))[1:]:
        long = np.linalg.norm(end) > 0.3
        for share in np.arange(1, 4) / 3.0 if long else [1.0]:
            links.append(link)
            centres.append(share * end)
            radii.append(0.09 if long else 0.07)
    return RobotSpheres(np.array(links), np.array(centres), np.array(radii))


def post(k: int) -> Spheres:
    """A post of 0.1 x 0.1 x 0.6 m in ``k`` spheres one above the other."""
    cell = 0.6 / k
    centres = np.array([[0.0, 0.0, (n + 0.5) * cell] for n in range(k)])
    return Spheres(centres, np.full(k, np.sqrt((cell / 2.0) ** 2 + 0.1**2 / 2.0)))


def quadrant_posts(k: int) -> LayoutProblem:
    """One station a quadrant, a post between any two, the whole arm in spheres, hulls of ``k`` spheres (1 or 10)."""
    arm = ur10e()
    tool = pose(np.array([0.0, 0.0, 0.15]), np.eye(3))
    above = Approach(pose(np.array([[0.0, 0.0, 0.3 if k == 1 else 0.2]]), DOWN[None]))
    hull = box_hull(BOX, (1, 1, 1) if k == 1 else (5, 2, 1), np.zeros(3))
    stations = [
        Station(
            f"station {n + 1}",
            ring((n * np.pi / 2.0 - 0.45, n * np.pi / 2.0 + 0.45), (0.55, 0.85), (0.0, 0.2)),
            hull,
            (above,),
        )
        for n in range(4)
    ]
    for n in range(4):
        angle = (n + 0.5) * np.pi / 2.0
        stand = pose(0.75 * np.array([np.cos(angle), np.sin(angle), 0.0]), np.eye(3))
        stations.append(Station(f"post {n + 1}", fixed(stand), post(k)))
    return LayoutProblem(arm, tuple(stations), robot_spheres=link_spheres(arm, tool), T_flange_tool=tool)
