"""Decide most collision questions of whole motions at once; the exact engine is asked about the rest.

Every body is wrapped in its convex hull. Two hulls that are certainly further apart than the clearance (Gilbert,
Johnson and Keerthi 1988, with certificates, `cellwright.cell.convex_gap`) are free; two bodies that fill their hulls
and certainly come closer are not; between the two, a state is open and `cellwright.cell.scene.Scene` decides it. From
one state to the next no pair comes closer by more than its levers times the joints' turns, so a pair is tested again
only when the distance found last may be used up: about 1 us a state for the UR10e, a tenth of asking the engine.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray
from cellwright.cell.bodies import BASE, WORLD
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import link_poses_into
from cellwright.cell.convex_gap import Hull, convex_gap, hull_of, hull_table
from cellwright.cell.scene import Scene, halving_order
from cellwright.cell.sphere_filter import relative_into
from cellwright.cell.transforms import inverse

_CERTAIN = 2e-6
"""Metres around the clearance in which the exact engine decides: more than both sides round."""


class FilteredScene:
    """A scene that is asked only about states that the hulls of its bodies leave open; it gives the same answers.

    Keeps scratch arrays like the scene: use one a thread.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        cell = scene.cell
        chain = cell.robot.chain
        self._chain_arrays = chain.T_parent_joint, chain.axis
        hulls = [hull_of(body.shape, _pose_in_frame(cell, row)) for row, body in enumerate(cell.bodies)]
        frames = [max(body.parent, BASE) for body in cell.bodies]
        # the body on the later link second, so that only the joints between the two move them against each other
        pairs = [sorted(pair, key=lambda row: frames[row]) for pair in scene.pairs.tolist()]
        self._pairs = np.array([(a, b, frames[a], frames[b]) for a, b in pairs], np.int64).reshape(-1, 4)
        levers = [_levers(cell, hulls[b], frames[a], frames[b]) for a, b in pairs]
        self._levers = np.array(levers).reshape(-1, chain.n_joints)
        self._table = hull_table(hulls)
        centres = np.array([0.5 * (hull.points.min(axis=0) + hull.points.max(axis=0)) for hull in hulls])
        radii = [
            float(np.linalg.norm(hull.points - centre, axis=1).max()) + hull.radius + hull.disc
            for hull, centre in zip(hulls, centres)
        ]
        self._balls = np.column_stack([centres, radii]).reshape(-1, 4)
        self._seen = np.zeros((len(self._pairs), 5))
        self._seen[:, 2] = -1.0

    def collides(self, q: FloatArray, /) -> bool:
        """Whether the robot collides at ``q`` (joints,) in rad."""
        return self.first_colliding(q[None]) >= 0

    def colliding_pair(self, q: FloatArray, /) -> tuple[str, str] | None:
        """Return the names of two bodies that collide at ``q`` (joints,) in rad, ``None`` if none do."""
        return self._scene.colliding_pair(q)

    def first_colliding(self, states: FloatArray, /) -> int:
        """Return the first of many states (n, joints) in rad that collides, -1 if none does.

        Fast where one follows the other closely.
        """
        blocked, still_open = self._decide(states)
        for row in still_open:
            if self._scene.collides(states[row]):
                return int(row)
        return blocked

    def motion_collides(self, q_a: FloatArray, q_b: FloatArray, step: float, /) -> bool:
        """Whether any state on the straight joint motion does, tried every ``step`` rad of the fastest joint."""
        n_steps = max(1, math.ceil(float(np.abs(q_b - q_a).max()) / step - 1e-9))
        states = q_a + (np.arange(n_steps + 1) / n_steps)[:, None] * (q_b - q_a)
        states[-1] = q_b
        blocked, still_open = self._decide(states)
        if blocked >= 0:
            return True
        n_open = len(still_open)
        # in the middle first: where much is open, a collision is found early
        return any(self._scene.collides(states[still_open[k - 1]]) for k in halving_order(n_open + 1))

    def _decide(self, states: FloatArray) -> tuple[int, Int32Array]:
        """Return the first state that certainly collides, -1 if none, and the open ones before it."""
        still_open = np.empty(len(states), np.int32)
        blocked, count = _decide_states(
            *self._chain_arrays,
            *self._table,
            self._balls,
            self._pairs,
            self._levers,
            np.ascontiguousarray(states, float),
            self._scene.clearance_m,
            self._seen,
            still_open,
        )
        return blocked, still_open[:count]


def _pose_in_frame(cell: Cell, row: int) -> FloatArray:
    body = cell.bodies[row]
    return inverse(cell.T_world_base) @ body.T_parent_body if body.parent == WORLD else body.T_parent_body


def _levers(cell: Cell, hull: Hull, first: int, last: int) -> FloatArray:
    """Bound how far a body on link ``last`` gets from the axes of the joints behind link ``first``, (joints,) in m."""
    chain = cell.robot.chain
    levers = np.zeros(chain.n_joints)
    reach = float(np.linalg.norm(hull.points, axis=1).max()) + hull.radius + hull.disc
    for joint in range(last - 1, first - 1, -1):
        levers[joint] = reach
        reach += float(np.linalg.norm(chain.T_parent_joint[joint, :3, 3]))
    return levers


@numba.njit(cache=True, nogil=True)
def _decide_states(
    T_parent_joint: FloatArray,
    axis: FloatArray,
    points: FloatArray,
    edge: IntArray,
    real: FloatArray,
    whole: IntArray,
    balls: FloatArray,
    pairs: IntArray,
    levers: FloatArray,
    states: FloatArray,
    clearance: float,
    seen: FloatArray,
    still_open: Int32Array,
) -> tuple[int, int]:
    """Return the first state that certainly collides (-1: none) and the number of open ones before it, written down."""
    n_pairs, n_joints = levers.shape
    links, relative, room = np.empty((n_joints + 1, 4, 4)), np.empty((4, 4)), np.empty((7, 4))
    reserve, used, turn = np.full(n_pairs, -1.0), np.zeros(n_pairs), np.zeros(n_joints)
    enough, count = clearance + _CERTAIN, 0
    for k in range(len(states)):
        placed, is_open = False, False
        if k > 0:
            for j in range(n_joints):
                turn[j] = abs(states[k, j] - states[k - 1, j])
        for p in range(n_pairs):
            used[p] = 0.0
            for j in range(pairs[p, 2], pairs[p, 3]):
                used[p] += levers[p, j] * turn[j]
            reserve[p] -= used[p]
            if reserve[p] >= enough:
                continue
            if not placed:
                link_poses_into(T_parent_joint, axis, states[k], links)
                placed = True
            a, b = pairs[p, 0], pairs[p, 1]
            relative_into(links, pairs[p, 2], pairs[p, 3], relative)
            square = 0.0
            for row in range(3):
                away = relative[row, 3] - balls[a, row]
                for column in range(3):
                    away += relative[row, column] * balls[b, column]
                square += away * away
            reserve[p] = math.sqrt(square) - balls[a, 3] - balls[b, 3]
            if reserve[p] >= enough:
                continue
            # a little more than enough, so that the next states need no test
            least, most = convex_gap(
                points, edge, real, whole, a, b, relative, enough + 3.0 * used[p], clearance - _CERTAIN, seen[p], room
            )
            reserve[p] = least
            if least < enough:
                if whole[a, 2] == 1 and whole[b, 2] == 1 and most < clearance - _CERTAIN:
                    return k, count
                is_open = True
        if is_open:
            still_open[count] = k
            count += 1
    return -1, count
