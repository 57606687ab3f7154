"""Small layout problems that tests solve in a blink: a two-joint robot that turns and reaches out."""

from __future__ import annotations

import numpy as np

from cellwright.cell.harness import DesignJoint, Harness, X, Z, fixed
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import pose
from cellwright.solvers.layout.problem import (
    Approach,
    LayoutProblem,
    RobotSpheres,
    Spheres,
    Station,
    TargetKind,
)

URDF = (
    '<robot name="polar"><link name="base"/><link name="turret"/><link name="beam"/>'
    '<joint name="swivel" type="revolute"><parent link="base"/><child link="turret"/><axis xyz="0 0 1"/>'
    '<limit lower="-6" upper="6" velocity="1.5" effort="1"/></joint>'
    '<joint name="reach" type="prismatic"><parent link="turret"/><child link="beam"/><axis xyz="1 0 0"/>'
    '<limit lower="0.3" upper="1.2" velocity="1" effort="1"/></joint></robot>'
)


def polar_arm() -> SerialArm:
    return SerialArm.from_urdf(URDF, max_acceleration=np.array([6.0, 4.0]))


def ring_harness(low: float, high: float, inner: float = 0.5, outer: float = 1.0) -> Harness:
    return Harness((DesignJoint("around", True, Z, low, high), DesignJoint("out", False, X, inner, outer)))


def polar_spheres() -> RobotSpheres:
    """The beam's tip, and the column."""
    return RobotSpheres(np.array([2, 0]), np.zeros((2, 3)), np.array([0.02, 0.15]))


def two_stations(
    *, obstacle: float = 0.0, radius: float = 0.1, ranges: tuple[tuple[float, float], ...] = ((-2, 0), (0, 2))
) -> LayoutProblem:
    """Two stations on a ring, reached by position from beside their hulls; if asked, a post stands between them."""
    beside = Approach(pose(np.array([[-0.2, 0.0, 0.0]]), np.eye(3)[None]), TargetKind.POSITION)
    hull = Spheres(np.zeros((1, 3)), np.array([radius]))
    stations = [Station(f"station {n}", ring_harness(*span), hull, (beside,)) for n, span in enumerate(ranges, 1)]
    if obstacle:
        post = Spheres(np.zeros((1, 3)), np.array([obstacle]))
        stations.append(Station("post", fixed(pose(np.array([0.8, 0.0, 0.0]), np.eye(3))), post))
    return LayoutProblem(polar_arm(), tuple(stations), robot_spheres=polar_spheres())
