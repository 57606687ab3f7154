"""Costs of motions between tasks, as `cellwright.solvers.motion_cost.MotionCost` asks for them.

`MotionTimes` plans the motion: collision-free by a roadmap of its own, by random trees where that finds no way, timed
under velocity and acceleration limits. `VelocityTimes` counts the time of the slowest joint at full speed, as cell
programmers often do, and plans only to know whether there is a motion at all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.solvers.connections import Connection, Connections, ConnectionSteps
from cellwright.solvers.motion_cost import CostedMotion
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.path_timing import Limits, least_time
from cellwright.solvers.random_trees import connect_by_trees
from cellwright.solvers.roadmap import CollisionChecker, Roadmap, RoadmapSize, travel_time

ROADMAP_MARGIN = 1.0
"""Rad by which the roadmap reaches beyond all configurations: detours are wider than what they connect."""
TREE_NODES, TREE_STEP = 1500, 0.5
"""Nodes of random trees, and their step as a share of the search's: they lead through narrow places."""


class MotionTimes:
    """Times of planned motions between configurations; what was planned is remembered, in both directions.

    Args:
        cell: The cell.
        checker: Scene by which motions are planned and confirmed.
        q: All configurations that motions may be asked for, (n, joints) in rad.
        size: Size of the roadmap.
        steps: How finely motions are checked.
        rng: Where random configurations come from.
    """

    name = "timed path"
    unit = "s"
    symmetric = True

    def __init__(
        self,
        cell: Cell,
        checker: CollisionChecker,
        q: FloatArray,
        *,
        size: RoadmapSize,
        steps: ConnectionSteps,
        rng: np.random.Generator,
    ) -> None:
        chain = cell.robot.chain
        self.limits = Limits(chain.max_velocity, chain.max_acceleration)
        self._checker, self._steps, self._hub = checker, steps, np.array(cell.start, float)
        roadmap_rng, shortening_rng, self._tree_rng = rng.spawn(3)
        ends = np.concatenate([q, self._hub[None]])
        lower = np.maximum(chain.lower, ends.min(axis=0) - ROADMAP_MARGIN)
        upper = np.minimum(chain.upper, ends.max(axis=0) + ROADMAP_MARGIN)
        self._roadmap = Roadmap(checker, lower, upper, self.limits.velocity, size=size, rng=roadmap_rng)
        self._connections = Connections(
            checker, self._roadmap, MovingCorners.of(cell), self.limits, steps, shortening_rng, hub=self._hub
        )
        self._cut_off: dict[bytes, bool] = {}

    @property
    def n_nodes(self) -> int:
        """The number of configurations of the roadmap."""
        return self._roadmap.n_nodes

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        """Return the time that the slowest joint needs under its limits, (...) in s."""
        return least_time(q_a, q_b, self.limits)

    def holding(self, q: FloatArray, dwell: float) -> FloatArray:
        """Return the dwell itself."""
        return np.full(np.shape(q)[:-1], float(dwell))

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        """Return the motion, confirmed in small steps, with its time in s; ``None`` if none was found.

        Limits hold within `cellwright.solvers.path_timing.LIMIT_TOLERANCE`, so a motion may seem to take less than
        the bound by that share; then the bound stands.
        """
        if any(self._cut_off.get(q.tobytes(), False) for q in (q_a, q_b)):
            return None
        found = self._confirmed(q_a, q_b)
        if found is None and all(self._has_way_out(q) for q in (q_a, q_b)):
            self._connections.forget_failures()
            found = self._confirmed(q_a, q_b)
        if found is None:
            return None
        cost = max(found.motion.duration, float(self.bound(q_a, q_b)))
        return CostedMotion(cost, found.motion, None, found.via)

    def is_cut_off(self, q: FloatArray) -> bool:
        """Whether no way was found from a configuration to the start, by roadmap or by random trees."""
        return self._cut_off.get(q.tobytes(), False)

    def _confirmed(self, q_a: FloatArray, q_b: FloatArray) -> Connection | None:
        self._connections.confirm(q_a, q_b)
        return self._connections.between(q_a, q_b)

    def _has_way_out(self, q: FloatArray) -> bool:
        """Tell whether a configuration is connected with the start; let random trees look for a way if it is not."""
        key = q.tobytes()
        if key in self._cut_off or np.array_equal(q, self._hub):
            return not self._cut_off.get(key, False)
        reached = self._confirmed(q, self._hub) is not None
        if not reached:
            low, high = self._roadmap.box
            step = TREE_STEP * self._steps.search
            path = connect_by_trees(
                self._checker, q, self._hub, (np.minimum(low, q), np.maximum(high, q)), self.limits.velocity,
                step=step, n_most=TREE_NODES, rng=self._tree_rng,
            )  # fmt: skip
            if path is not None:
                self._roadmap.seed_path(path, step)
                reached = True
        self._cut_off[key] = not reached
        return reached


class VelocityTimes:
    """Times of the slowest joint at full speed; motions are planned only to know that there are any."""

    name = "velocity bound"
    unit = "s"
    symmetric = True

    def __init__(self, planned: MotionTimes) -> None:
        self._planned = planned

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        """Return the time of the slowest joint at full speed, (...) in s."""
        return travel_time(q_a, q_b, self._planned.limits.velocity)

    def holding(self, q: FloatArray, dwell: float) -> FloatArray:
        """Return the dwell itself."""
        return self._planned.holding(q, dwell)

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        """Return the planned motion at the cost of the bound, ``None`` if none was found."""
        found = self._planned.motion(q_a, q_b)
        return None if found is None else replace(found, cost=float(self.bound(q_a, q_b)))
