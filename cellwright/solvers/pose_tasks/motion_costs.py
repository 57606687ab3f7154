"""Times of motions between tasks: collision-free by a roadmap of its own, by random trees where that finds no way."""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.solvers.connections import Connections, ConnectionSteps
from cellwright.solvers.motion_cost import CostedMotion, PathCost
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.path_timing import Limits
from cellwright.solvers.random_trees import connect_by_trees
from cellwright.solvers.roadmap import CollisionChecker, Roadmap, RoadmapSize

ROADMAP_MARGIN = 1.0
"""Rad by which the roadmap reaches beyond all configurations: detours are wider than what they connect."""
TREE_NODES, TREE_STEP = 1500, 0.5
"""Nodes of random trees, and their step as a share of the search's: they lead through narrow places."""


class MotionTimes(PathCost):
    """A `PathCost` with a roadmap of its own; what was planned is remembered, in both directions.

    Args:
        cell: The cell.
        checker: Scene by which motions are planned and confirmed.
        q: All configurations that motions may be asked for, (n, joints) in rad.
        size: Size of the roadmap.
        steps: How finely motions are checked.
        rng: Where random configurations come from.
    """

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
        limits = Limits(chain.max_velocity, chain.max_acceleration)
        self._checker, self._steps, self._hub = checker, steps, np.array(cell.start, float)
        roadmap_rng, shortening_rng, self._tree_rng = rng.spawn(3)
        ends = np.concatenate([q, self._hub[None]])
        lower = np.maximum(chain.lower, ends.min(axis=0) - ROADMAP_MARGIN)
        upper = np.minimum(chain.upper, ends.max(axis=0) + ROADMAP_MARGIN)
        self._roadmap = Roadmap(checker, lower, upper, limits.velocity, size=size, rng=roadmap_rng)
        corners = MovingCorners.of(cell)
        connections = Connections(
            checker, self._roadmap, corners, limits, steps, shortening_rng, hub=self._hub, own_shortenings=True
        )
        super().__init__(connections, limits)
        self._cut_off: dict[bytes, bool] = {}

    @property
    def n_nodes(self) -> int:
        """The number of configurations of the roadmap."""
        return self._roadmap.n_nodes

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        """Return the motion, confirmed in small steps, with its time in s; ``None`` if none was found."""
        if any(self._cut_off.get(q.tobytes(), False) for q in (q_a, q_b)):
            return None
        found = super().motion(q_a, q_b)
        if found is None and all(self._has_way_out(q) for q in (q_a, q_b)):
            self.connections.forget_failures()
            found = super().motion(q_a, q_b)
        return found

    def _has_way_out(self, q: FloatArray) -> bool:
        """Tell whether a configuration is connected with the start; let random trees look for a way if it is not."""
        key = q.tobytes()
        if key in self._cut_off or np.array_equal(q, self._hub):
            return not self._cut_off.get(key, False)
        reached = super().motion(q, self._hub) is not None
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
