"""The small functions that layout programs are made of: a tool's error, a gap, a joint's travel, the extra cost.

Each is a `LocalFunction` of the variables it touches (one or two configurations, the design joints of the base and of
one station), made and differentiated once a problem and shared by stations on the same kind of harness. Everything is
in the world frame.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any

import casadi
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.harness import Harness
from cellwright.cell.symbolic_model import SymbolicModel, symbolic_model
from cellwright.solvers.layout.costs import cost_expression
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.problem import LayoutProblem, TargetKind
from cellwright.solvers.structured_program import LocalFunction

_SMOOTHING = 1e-10
"""Square metres under the root of a distance, so that it has a gradient everywhere (1e-5 m at contact of centres)."""


class Place(Enum):
    """Where between two configurations a check sits, and thus on which variables it depends."""

    ROW = "row"
    """At one configuration."""
    LINE = "line"
    """On the straight line between two."""
    ARC = "arc"
    """Between two, at constant acceleration."""


class LayoutSymbols:
    """The expressions of one problem; they are made when first asked for, so solvers share one object."""

    def __init__(self, problem: LayoutProblem) -> None:
        self.problem = problem
        self.geometry = LayoutGeometry(problem)
        self.model: SymbolicModel = symbolic_model(problem.arm, problem.T_flange_tool)
        self._made: dict[tuple[Any, ...], LocalFunction] = {}

    def _once(self, key: tuple[Any, ...], make: Callable[[], LocalFunction]) -> LocalFunction:
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def _harness(self, station: int) -> Harness:
        return self.problem.stations[station].harness

    def _key(self, station: int) -> bytes:
        """Return what makes two stations' harnesses the same; empty if the station is fixed."""
        harness = self._harness(station)
        if not harness.n_joints:
            return b""
        arrays = (harness.T_parent_joint, harness.axis, harness.revolute, harness.T_last_carried)
        return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)

    def in_station(self, station: int, points: FloatArray) -> FloatArray:
        """Return points (n, 3) of a station as its functions want them: its own frame, or the world if it is fixed."""
        harness = self._harness(station)
        if harness.n_joints:
            return points
        T = harness.poses(np.zeros(0))
        return np.asarray(points @ T[:3, :3].T + T[:3, 3])

    def _base_pose(self, design: Any) -> Any:
        return self.problem.base.symbolic_pose(design)

    def _station_pose(self, station: int, design: Any) -> Any:
        """Return ``T_world_station``, or the identity if it is fixed and its points are given in the world."""
        harness = self._harness(station)
        return harness.symbolic_pose(design) if harness.n_joints else casadi.SX.eye(4)

    def _configuration(self, place: Place) -> tuple[Any, Any, Any]:
        """Return a configuration as an expression, the variables and the constants it is made of."""
        n = self.model.n_joints
        before = casadi.SX.sym("before", n)
        if place is Place.ROW:
            return before, before, casadi.SX(0, 1)
        after, share = casadi.SX.sym("after", n), casadi.SX.sym("share")
        q = (1.0 - share) * before + share * after
        if place is Place.LINE:
            return q, casadi.vertcat(before, after), share
        speed_before, speed_after = casadi.SX.sym("speed_before", n), casadi.SX.sym("speed_after", n)
        time, part = casadi.SX.sym("time"), casadi.SX.sym("part")
        scale = casadi.DM(self.problem.arm.max_velocity)
        q += 0.5 * time * part * share * (1.0 - share) * scale * (speed_before - speed_after)
        return q, casadi.vertcat(before, after, speed_before, speed_after, time), casadi.vertcat(share, part)

    def _centre(self, q: Any, base: Any, link: int, local: Any) -> Any:
        T = self._base_pose(base) @ self.model.link_poses(q)[link]
        return T[:3, :3] @ local + T[:3, 3]

    def _designs(self, station: int | None = None) -> tuple[Any, Any]:
        base = casadi.SX.sym("base", self.problem.base.n_joints)
        own = casadi.SX.sym("station", 0 if station is None else self._harness(station).n_joints)
        return base, own

    def target(self, kind: TargetKind, station: int) -> LocalFunction:
        """Return z = (q, base, station), p = pose by columns (12) to equations, and last what must not be negative.

        The skew part of the rotation error vanishes at half a turn too, which the last output excludes; targets by
        position have none.
        """

        def make() -> LocalFunction:
            z, p, shift, R = self._error(station)
            if kind is TargetKind.POSITION:
                return LocalFunction("target", z, p, shift)
            if kind is TargetKind.AXIS:
                return LocalFunction("target", z, p, casadi.vertcat(shift, R[:2, 2], R[2, 2]))
            turn = 0.5 * casadi.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
            return LocalFunction("target", z, p, casadi.vertcat(shift, turn, casadi.trace(R) - 1.0))

        return self._once(("target", kind, self._key(station)), make)

    def tracking(self, kind: TargetKind, station: int) -> LocalFunction:
        """Return z, p as `target` to the squared distance plus the squared turn (for small ones)."""

        def make() -> LocalFunction:
            z, p, shift, R = self._error(station)
            cost = casadi.sumsqr(shift)
            if kind is TargetKind.AXIS:
                cost += 2.0 * (1.0 - R[2, 2])
            elif kind is TargetKind.POSE:
                cost += 3.0 - casadi.trace(R)
            return LocalFunction("tracking", z, p, cost)

        return self._once(("tracking", kind, self._key(station)), make)

    def _error(self, station: int) -> tuple[Any, Any, Any, Any]:
        q, p = casadi.SX.sym("q", self.model.n_joints), casadi.SX.sym("goal", 12)
        base, own = self._designs(station)
        T = self._base_pose(base) @ self.model.tip_pose(q)
        goal, T_station = casadi.reshape(p, 3, 4), self._station_pose(station, own)
        R_goal, position = T_station[:3, :3] @ goal[:, :3], T_station[:3, :3] @ goal[:, 3] + T_station[:3, 3]
        return casadi.vertcat(q, base, own), p, T[:3, 3] - position, R_goal.T @ T[:3, :3]

    def goal_constants(self, station: int, T_station_tool: FloatArray) -> FloatArray:
        """Return the constants (n, 12) of `target` for poses (n, 4, 4)."""
        harness = self._harness(station)
        T = T_station_tool if harness.n_joints else harness.poses(np.zeros(0)) @ T_station_tool
        return np.asarray(np.swapaxes(T[:, :3, :], 1, 2).reshape(-1, 12))

    def hull_gap(self, link: int, station: int, place: Place) -> LocalFunction:
        """Return z = (configuration, base, station), p = (place, sphere (3), hull centre (3), radii) to the gap."""

        def make() -> LocalFunction:
            q, variables, where = self._configuration(place)
            base, own = self._designs(station)
            p = casadi.SX.sym("p", 7)
            T = self._station_pose(station, own)
            apart = self._centre(q, base, link, p[:3]) - T[:3, :3] @ p[3:6] - T[:3, 3]
            z = casadi.vertcat(variables, base, own)
            return LocalFunction("gap", z, casadi.vertcat(where, p), _length(apart) - p[6])

        return self._once(("hull", link, self._key(station), place), make)

    def centre(self, link: int) -> LocalFunction:
        """Return z = (q, base, centre (3)), p = sphere (3) to how far the sphere's centre lies from that centre."""

        def make() -> LocalFunction:
            q, variables, _ = self._configuration(Place.ROW)
            base, _ = self._designs()
            c, p = casadi.SX.sym("c", 3), casadi.SX.sym("p", 3)
            z = casadi.vertcat(variables, base, c)
            return LocalFunction("centre", z, p, self._centre(q, base, link, p) - c)

        return self._once(("centre", link), make)

    def point_gap(self, station: int) -> LocalFunction:
        """Return z = (centre (3), station), p = (hull centre (3), radii) to the gap."""

        def make() -> LocalFunction:
            _, own = self._designs(station)
            c, p = casadi.SX.sym("c", 3), casadi.SX.sym("p", 4)
            T = self._station_pose(station, own)
            apart = c - T[:3, :3] @ p[:3] - T[:3, 3]
            return LocalFunction("gap", casadi.vertcat(c, own), p, _length(apart) - p[3])

        return self._once(("point", self._key(station)), make)

    def wall_gap(self, link: int, place: Place) -> LocalFunction:
        """Return z = (configuration, base), p = (place, sphere (3), normal (3), offset) to the gap."""

        def make() -> LocalFunction:
            q, variables, where = self._configuration(place)
            base, _ = self._designs()
            p = casadi.SX.sym("p", 7)
            gap = casadi.dot(self._centre(q, base, link, p[:3]), p[3:6]) - p[6]
            return LocalFunction("gap", casadi.vertcat(variables, base), casadi.vertcat(where, p), gap)

        return self._once(("wall", link, place), make)

    def self_gap(self, one: int, other: int, place: Place) -> LocalFunction:
        """Return z = configuration, p = (place, sphere (3), other sphere (3), radii) to the gap."""

        def make() -> LocalFunction:
            q, variables, where = self._configuration(place)
            p = casadi.SX.sym("p", 7)
            links = self.model.link_poses(q)
            apart = links[one][:3, :3] @ p[:3] + links[one][:3, 3] - links[other][:3, :3] @ p[3:6] - links[other][:3, 3]
            return LocalFunction("gap", variables, casadi.vertcat(where, p), _length(apart) - p[6])

        return self._once(("self", one, other, place), make)

    def stations_gap(self, one: int, other: int) -> LocalFunction:
        """Return z = (station, other station), p = (centre (3), other centre (3), radii) to the gap."""

        def make() -> LocalFunction:
            first = casadi.SX.sym("one", self._harness(one).n_joints)
            second = casadi.SX.sym("other", self._harness(other).n_joints)
            p = casadi.SX.sym("p", 7)
            T, G = self._station_pose(one, first), self._station_pose(other, second)
            apart = T[:3, :3] @ p[:3] + T[:3, 3] - G[:3, :3] @ p[3:6] - G[:3, 3]
            return LocalFunction("gap", casadi.vertcat(first, second), p, _length(apart) - p[6])

        return self._once(("stations", self._key(one), self._key(other)), make)

    def base_gap(self, station: int) -> LocalFunction:
        """Return z = (base, station), p = (sphere (3), hull centre (3), radii) to the gap."""

        def make() -> LocalFunction:
            base, own = self._designs(station)
            p = casadi.SX.sym("p", 7)
            T, G = self._base_pose(base), self._station_pose(station, own)
            apart = T[:3, :3] @ p[:3] + T[:3, 3] - G[:3, :3] @ p[3:6] - G[:3, 3]
            return LocalFunction("gap", casadi.vertcat(base, own), p, _length(apart) - p[6])

        return self._once(("base", self._key(station)), make)

    def station_wall_gap(self, station: int) -> LocalFunction:
        """Return z = station, p = (hull centre (3), normal (3), offset) to the gap."""

        def make() -> LocalFunction:
            _, own = self._designs(station)
            p = casadi.SX.sym("p", 7)
            T = self._station_pose(station, own)
            gap = casadi.dot(T[:3, :3] @ p[:3] + T[:3, 3], p[3:6]) - p[6]
            return LocalFunction("gap", own, p, gap)

        return self._once(("station wall", self._key(station)), make)

    def base_wall_gap(self) -> LocalFunction:
        """Return z = base, p = (sphere (3), normal (3), offset) to the gap."""

        def make() -> LocalFunction:
            base, _ = self._designs()
            p = casadi.SX.sym("p", 7)
            T = self._base_pose(base)
            gap = casadi.dot(T[:3, :3] @ p[:3] + T[:3, 3], p[3:6]) - p[6]
            return LocalFunction("gap", base, p, gap)

        return self._once(("base wall",), make)

    def travel(self) -> LocalFunction:
        """Return z = (before, after, time), p = (speed, acceleration) limits of one joint to what it has to spare.

        From rest to rest a joint covers ``a T^2 / 4`` while it does not reach its speed, else ``v T - v^2 / a``.
        """

        def make() -> LocalFunction:
            z, p = casadi.SX.sym("z", 3), casadi.SX.sym("p", 2)
            T, v, a = z[2], p[0], p[1]
            most = casadi.if_else(T * a - 2.0 * v < 0.0, 0.25 * a * T**2, v * T - v * v / a)
            return LocalFunction("travel", z, p, casadi.vertcat(most - (z[1] - z[0]), most + (z[1] - z[0])))

        return self._once(("travel",), make)

    def shift(self) -> LocalFunction:
        """Return z = (before, after, speed before, speed after, time), p = (scale of speed, part) to the defect.

        Constant acceleration over a part of the time; speeds are shares of the joint's limit.
        """

        def make() -> LocalFunction:
            z, p = casadi.SX.sym("z", 5), casadi.SX.sym("p", 2)
            return LocalFunction("shift", z, p, z[1] - z[0] - 0.5 * z[4] * p[1] * p[0] * (z[2] + z[3]))

        return self._once(("shift",), make)

    def _cost(self) -> tuple[Any, Any]:
        """Return a configuration and its extra cost, which the first joint cannot change: it moves the arm as a whole.

        So the first joint is held at zero in the expression, which leaves fewer derivatives.
        """
        q = casadi.SX.sym("q", self.model.n_joints)
        held = casadi.vertcat(casadi.SX(0.0), q[1:])
        return q, cost_expression(self.model.jacobian(held), self.problem.cost)

    def extra_cost(self) -> LocalFunction:
        """Return z = q to one configuration's share of the extra cost L."""

        def make() -> LocalFunction:
            q, cost = self._cost()
            return LocalFunction("cost", q, casadi.SX(0, 1), cost)

        return self._once(("cost",), make)

    def knot_cost(self) -> LocalFunction:
        """Return z = (q, total time), p = seconds to that configuration's part in the mean cost over the time."""

        def make() -> LocalFunction:
            q, cost = self._cost()
            total, seconds = casadi.SX.sym("total"), casadi.SX.sym("seconds")
            return LocalFunction("cost", casadi.vertcat(q, total), seconds, seconds / total * cost)

        return self._once(("knot cost",), make)

    def path_cost(self, place: Place) -> LocalFunction:
        """Return z = (configuration, time, total time), p = (share, part, weight) to a place's part in the mean cost.

        The place lies at a share of a segment, which lasts a part of a time, and stands for its weight of the segment.
        """

        def make() -> LocalFunction:
            q, variables, where = self._configuration(place)
            total, weight = casadi.SX.sym("total"), casadi.SX.sym("weight")
            if place is Place.ARC:
                time, part = variables[-1], where[1]
            else:
                time, part = casadi.SX.sym("time"), casadi.SX.sym("part")
                variables, where = casadi.vertcat(variables, time), casadi.vertcat(where, part)
            z, p = casadi.vertcat(variables, total), casadi.vertcat(where, weight)
            here, cost = self._cost()
            return LocalFunction.scaled("cost", z, p, time * part * weight / total, here, cost, q)

        return self._once(("path cost", place), make)


def _length(vector: Any) -> Any:
    return casadi.sqrt(casadi.sumsqr(vector) + _SMOOTHING)
