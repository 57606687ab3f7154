"""How a layout program is cut into configurations: the knots of approaches, and the segments of transitions.

Rows number the configurations of the whole cycle. The last knot of a visit is the first configuration of the next
transition, so that the robot's joints never jump.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.layout.approach import Knots, approach_knots
from cellwright.solvers.layout.problem import LayoutProblem

HULL, WALL, SELF = 0, 1, 2
"""What a robot sphere is checked against."""
STATIONS, BASE, WALLS, BASE_WALLS = 0, 1, 2, 3
"""Which of `LayoutGeometry.pair_families` a layout check belongs to."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Configurations and times of a cycle.

    Attributes:
        knots: Of each visit; None at home.
        visit_rows: Rows of each visit's knots.
        transition_rows: Rows of each transition, ends included.
        segment_time: Which time variable each segment of each transition uses.
        segment_share: What part of that time the segment lasts.
        n_configs, n_times: Sizes.
    """

    knots: tuple[Knots | None, ...]
    visit_rows: tuple[IntArray, ...]
    transition_rows: tuple[IntArray, ...]
    segment_time: tuple[IntArray, ...]
    segment_share: tuple[FloatArray, ...]
    n_configs: int
    n_times: int

    @property
    def n_segments(self) -> int:
        """Segments a transition."""
        return len(self.transition_rows[0]) - 1

    def interpolated(self, visit_q: list[FloatArray]) -> FloatArray:
        """Return all configurations (n_configs, joints) with straight transitions between visits' knots."""
        q = np.empty((self.n_configs, visit_q[0].shape[1]))
        for rows, values in zip(self.visit_rows, visit_q):
            q[rows] = values
        for rows in self.transition_rows:
            share = np.linspace(0.0, 1.0, len(rows))[1:-1, None]
            q[rows[1:-1]] = (1.0 - share) * q[rows[0]] + share * q[rows[-1]]
        return q


def build_mesh(problem: LayoutProblem, n_segments: int, *, free_times: bool = False) -> Mesh:
    """Return the mesh with ``n_segments`` a transition, each of the same duration or, if free, of its own."""
    knots: list[Knots | None] = []
    visit_rows: list[IntArray] = []
    n_configs = 0
    for visit in range(len(problem.visits)):
        approach = problem.approach_of(visit)
        knots.append(None if approach is None else approach_knots(approach))
        count = 1 if approach is None else len(knots[-1].place)  # type: ignore[union-attr]
        visit_rows.append(np.arange(n_configs, n_configs + count))
        n_configs += count
    transition_rows, segment_time, segment_share = [], [], []
    for number, (start, end) in enumerate(problem.transitions):
        inner = np.arange(n_configs, n_configs + n_segments - 1)
        n_configs += n_segments - 1
        transition_rows.append(np.concatenate([visit_rows[start][-1:], inner, visit_rows[end][:1]]))
        if free_times:
            segment_time.append(np.arange(number * n_segments, (number + 1) * n_segments))
            segment_share.append(np.ones(n_segments))
        else:
            segment_time.append(np.full(n_segments, number))
            segment_share.append(np.full(n_segments, 1.0 / n_segments))
    n_times = len(problem.transitions) * (n_segments if free_times else 1)
    return Mesh(
        tuple(knots),
        tuple(visit_rows),
        tuple(transition_rows),
        tuple(segment_time),
        tuple(segment_share),
        n_configs,
        n_times,
    )


def path_mesh(n_segments: int) -> Mesh:
    """Return the mesh of a single motion of segments with their own durations, without visits."""
    each = np.arange(n_segments)
    return Mesh((), (), (np.arange(n_segments + 1),), (each,), (np.ones(n_segments),), n_segments + 1, n_segments)


@dataclass(frozen=True, eq=False)
class Checks:
    """Collision constraints of a layout program, one row each.

    Attributes:
        motion: Row before, row after, transition (-1: none), what against (`HULL`, `WALL`, `SELF`), robot sphere,
            the other (hull sphere, wall, robot sphere), (n, 6).
        share: Where between the two rows, (n,).
        layout: Family (`STATIONS`, `BASE`, `WALLS`, `BASE_WALLS`) and the row of that family's pairs, (m, 2).
    """

    motion: IntArray = field(default_factory=lambda: np.zeros((0, 6), np.int64))
    share: FloatArray = field(default_factory=lambda: np.zeros(0))
    layout: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.int64))

    @property
    def n_checks(self) -> int:
        """The number of constraints."""
        return len(self.motion) + len(self.layout)

    def joined(self, other: Checks) -> Checks:
        """Return both together, sorted, each once."""
        motion = np.concatenate([self.motion, other.motion])
        share = np.concatenate([self.share, other.share])
        keys = np.column_stack([motion[:, 2:], motion[:, :2], np.round(share * 1e6)]).astype(np.int64)
        _, first = np.unique(keys, axis=0, return_index=True)
        layout = np.unique(np.concatenate([self.layout, other.layout]), axis=0)
        return Checks(motion[first], share[first], layout)
