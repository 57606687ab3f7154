"""What an arm can do at each pose of a sweep, branch by branch: kernels of `cellwright.solvers.sweeps.following`.

A sweep is a row of flange poses a step apart with one orientation. Its *states* are the inverse kinematics solutions
at these poses, ordered into *branches*: a branch's joints are continuous from pose to pose wherever ``linked`` says so,
unwrapped across full turns. What the last link carries stands at each pose wherever the arm is; it is tested once a
pose. Pairs of bodies are tested again only when they may have come close since the last test.

Between two poses every point of the arm is taken to stay within 0.6 of its way of the nearer of the two (0.5 would be
a straight line), so a state counts as free only if the clearance or that is kept, whichever is more.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array, IntArray
from cellwright.cell.chain_kinematics import link_poses_into
from cellwright.cell.sphere_filter import BY_NONE, greatest_shift
from cellwright.solvers.joint_branches import order_branches, within_limits
from cellwright.solvers.state_tests import (
    BEYOND_LIMITS,
    CLEAR,
    COLLIDING,
    UNDECIDED,
    UNREACHED,
    FilterArrays,
    arm_state,
    tool_states,
    witnessed,
)


@numba.njit(cache=True, nogil=True)
def _mark_blocked(
    f: FilterArrays,
    T_parent_joint: FloatArray,
    axis: FloatArray,
    q: FloatArray,
    stride: int,
    clearance: float,
    status: Int8Array,
    blocker: Int32Array,
    direction: FloatArray,
    simplex: FloatArray,
) -> None:
    """Find colliding states of a branch at every ``stride``-th pose, and take those between two of them to collide.

    The stride is at most the shortest piece in steps, so no piece that would count fits between the two.
    """
    node, child, carrier, real, whole, lower, upper, hull_points, hull_edge, hull_real, hull_whole, pair, _ = f
    n, n_joints = q.shape
    links, relative = np.empty((n_joints + 1, 4, 4)), np.empty((4, 4))
    centres = np.empty((len(carrier), 3))
    still, reserve, witness = np.zeros(len(pair)), np.empty(len(pair)), np.array([0, BY_NONE])
    before = -1
    for k in range(0, n, stride):
        if status[k] == CLEAR:
            link_poses_into(T_parent_joint, axis, q[k], links)
            found, body = COLLIDING, pair[witness[0], 4]
            if not witnessed(
                node,
                carrier,
                real,
                whole,
                lower,
                upper,
                hull_points,
                hull_edge,
                hull_real,
                hull_whole,
                pair,
                links,
                clearance,
                witness,
                relative,
                direction,
                simplex,
            ):
                reserve[:] = -1.0
                found, body = arm_state(
                    node,
                    child,
                    carrier,
                    real,
                    whole,
                    lower,
                    upper,
                    hull_points,
                    hull_edge,
                    hull_real,
                    hull_whole,
                    pair,
                    n_joints,
                    links,
                    still,
                    clearance,
                    reserve,
                    witness,
                    relative,
                    centres,
                    direction,
                    simplex,
                )
            if found == COLLIDING:
                status[k], blocker[k] = COLLIDING, body
        if status[k] != COLLIDING:
            before = -1
            continue
        if before >= 0:
            for between in range(before + 1, k):
                if status[between] == CLEAR:
                    status[between], blocker[between] = COLLIDING, blocker[k]
        before = k


@numba.njit(cache=True, nogil=True, _nrt=False)
def _shifts_into(
    node: FloatArray,
    carrier: IntArray,
    pair: IntArray,
    lever: FloatArray,
    links: FloatArray,
    following: FloatArray,
    q: FloatArray,
    k: int,
    ways: FloatArray,
    out: FloatArray,
) -> float:
    """Write how far the bodies of each pair move against each other from one pose to the next to ``out``, in m.

    The lesser of two bounds: the ways of both bodies in the base (``ways`` is room for them), and the turns
    of the joints of ``q`` (poses, joints) between them from pose ``k`` on, times their levers. Returns the greatest.
    """
    for m in range(len(carrier)):
        ways[m] = greatest_shift(links, following, carrier[m], node, m)
    greatest = 0.0
    for p in range(len(pair)):
        swing = 0.0
        for joint in range(pair[p, 2], carrier[pair[p, 0]]):
            swing += abs(q[k + 1, joint] - q[k, joint]) * lever[p, joint]
        other = pair[p, 3]
        out[p] = min(swing, ways[pair[p, 0]] + (ways[other] if other >= 0 else 0.0))
        greatest = max(greatest, out[p])
    return greatest


@numba.njit(cache=True, nogil=True)
def _branch_states(
    f: FilterArrays,
    T_parent_joint: FloatArray,
    axis: FloatArray,
    q: FloatArray,
    linked: BoolArray,
    stride: int,
    clearance: float,
    tool_status: Int8Array,
    tool_blocker: Int32Array,
    status: Int8Array,
    blocker: Int32Array,
    shift: FloatArray,
) -> None:
    """Test the states ``q`` (poses, joints) of one branch that are within limits (``status`` says CLEAR so far).

    ``shift`` (poses,) receives how far any two bodies move against each other since the pose before, in m, where
    the two states are linked and neither collides.
    """
    node, child, carrier, real, whole, lower, upper, hull_points, hull_edge, hull_real, hull_whole, pair, lever = f
    n, n_joints = q.shape
    n_pairs = len(pair)
    links, following = np.empty((n_joints + 1, 4, 4)), np.empty((n_joints + 1, 4, 4))
    before, after, ways = np.zeros(n_pairs), np.zeros(n_pairs), np.empty(len(carrier))
    reserve, relative, centres = np.full(n_pairs, -1.0), np.empty((4, 4)), np.empty((len(carrier), 3))
    direction, simplex, witness = np.zeros((n_pairs, 5)), np.empty((7, 4)), np.array([0, BY_NONE])
    shift[:] = 0.0
    for k in range(n):
        if status[k] == CLEAR and tool_status[k] == COLLIDING:
            status[k], blocker[k] = COLLIDING, tool_blocker[k]
    _mark_blocked(f, T_parent_joint, axis, q, stride, clearance, status, blocker, direction, simplex)
    known = arrived = False
    for k in range(n):
        if status[k] != CLEAR:
            known = arrived = False
            continue
        if not known:
            link_poses_into(T_parent_joint, axis, q[k], links)
        if witness[1] != BY_NONE and witnessed(
            node,
            carrier,
            real,
            whole,
            lower,
            upper,
            hull_points,
            hull_edge,
            hull_real,
            hull_whole,
            pair,
            links,
            clearance,
            witness,
            relative,
            direction,
            simplex,
        ):
            status[k], blocker[k] = COLLIDING, pair[witness[0], 4]
            known = arrived = False
            continue
        if not arrived:
            reserve[:] = -1.0
            before[:] = 0.0
        goes_on = k + 1 < n and linked[k + 1] and status[k + 1] == CLEAR
        for p in range(n_pairs):
            after[p] = 0.0
        if goes_on:
            link_poses_into(T_parent_joint, axis, q[k + 1], following)
            shift[k + 1] = _shifts_into(node, carrier, pair, lever, links, following, q, k, ways, after)
        for p in range(n_pairs):
            before[p] = max(before[p], after[p])
        status[k], blocker[k] = arm_state(
            node,
            child,
            carrier,
            real,
            whole,
            lower,
            upper,
            hull_points,
            hull_edge,
            hull_real,
            hull_whole,
            pair,
            n_joints,
            links,
            before,
            clearance,
            reserve,
            witness,
            relative,
            centres,
            direction,
            simplex,
        )
        if status[k] == CLEAR and tool_status[k] == UNDECIDED:
            status[k], blocker[k] = UNDECIDED, tool_blocker[k]
        known = goes_on
        arrived = goes_on and status[k] != COLLIDING
        if goes_on:
            for p in range(n_pairs):
                reserve[p] -= after[p]
            before, after = after, before
            links, following = following, links


@numba.njit(cache=True, nogil=True)
def classify_sweep(
    f: FilterArrays,
    T_parent_joint: FloatArray,
    axis: FloatArray,
    lowest: FloatArray,
    highest: FloatArray,
    greatest: FloatArray,
    T_base_last: FloatArray,
    q: FloatArray,
    places_kept: bool,
    step: float,
    clearance: float,
    shortest: float,
    linked: BoolArray,
    status: Int8Array,
    blocker: Int32Array,
    shift: FloatArray,
) -> None:
    """Order and unwrap the solutions ``q`` (poses, branches, joints) of one sweep in place and test every state.

    ``lowest``, ``highest`` (joints,): joint limits in rad; ``greatest`` (joints,): largest change a step in rad;
    ``T_base_last`` (poses, 4, 4): pose of the last link; ``step``: distance of the poses in m; ``shortest``: least
    length of a piece in m. Writes ``linked``, ``status``, ``blocker`` (row of the body in the way or -1) and ``shift``
    (furthest way of any two bodies against each other since the pose before, m), all (branches, poses).
    """
    n, n_branches, n_joints = q.shape
    place = np.empty((n, n_branches), np.bool_)
    order_branches(q, places_kept, greatest, place)
    tool_status, tool_blocker = np.empty(n, np.int8), np.empty(n, np.int32)
    tool_states(f, n_joints, T_base_last, step, clearance, tool_status, tool_blocker)
    path = np.empty((n, n_joints))
    stride = max(1, math.ceil(shortest / step - 1e-6)) if step > 0.0 else 1
    for branch in range(n_branches):
        for k in range(n):
            linked[branch, k] = place[k, branch]
            blocker[branch, k] = -1
            status[branch, k] = UNREACHED if math.isnan(q[k, branch, 0]) else CLEAR
            for joint in range(n_joints):
                path[k, joint] = q[k, branch, joint]
                if status[branch, k] == CLEAR and not within_limits(path[k, joint], lowest[joint], highest[joint]):
                    status[branch, k] = BEYOND_LIMITS
        _branch_states(
            *(f, T_parent_joint, axis, path, linked[branch], stride, clearance, tool_status, tool_blocker),
            *(status[branch], blocker[branch], shift[branch]),
        )
