"""What a planning chain asks of its bare kernels, counted, and timed on these very items.

The kernels of the chain are compiled once more from their own code, with recorders in the place of the bare kernels
that they call: rays, forward kinematics, tests of bounding balls, comparisons of hulls and balls. After every call,
what was recorded is done again in tight compiled loops on one thread, and those are timed; what it takes to read the
recording alone is taken off. Inverse kinematics and the exact engine are timed where they are called. So the count
cannot drift from the code, and normal runs pay nothing for it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from types import FunctionType
from typing import Any
from unittest import mock

import numba
import numpy as np
from numba.core import cgutils, types
from numba.extending import intrinsic

from cellwright.cell import parallel_axes
from cellwright.cell.chain_kinematics import link_poses_into
from cellwright.cell.convex_gap import convex_gap
from cellwright.cell.occlusion import trace_segments
from cellwright.cell.scene import Scene
from cellwright.cell.sphere_filter import ball_bounds, bounding_gap, centres_into, compare_bodies, relative_into
from cellwright.solvers import measurability, state_tests
from cellwright.solvers.sweeps import following as sweep_following
from cellwright.solvers.sweeps import pieces as sweep_pieces
from cellwright.solvers.sweeps import states as sweep_states

POSES_PER_CHUNK = 512
"""So few that what is recorded of a chunk stays near the processor."""
MOST_BODIES = 32
JOINTS, PLACED, BOUNDS, FRAMES, COMPARED, RAYS, BATCHES = range(7)
WIDTHS = (6, 3 * MOST_BODIES, 2, 16, 22, 6, 1)
"""Numbers recorded of a call: joints; centres of balls; pair and row of centres; a pose; see `_compared`; a segment."""
CAPACITIES = (1 << 17, 1 << 17, 1 << 22, 1 << 20, 1 << 20, 1 << 20, 1 << 17)
WHOLE_BODY, HULLS, BALL = range(3)
"""What was compared: two bodies, two hulls, a ball and a body."""

# untouched memory of these costs nothing
LOGS = [np.empty((capacity, width)) for capacity, width in zip(CAPACITIES, WIDTHS)]
COUNTS = np.zeros(len(LOGS), np.int64)
JOINTS_AT, PLACED_AT, BOUNDS_AT, FRAMES_AT, COMPARED_AT, RAYS_AT, BATCHES_AT = (log.ctypes.data for log in LOGS)
COUNTS_AT = COUNTS.ctypes.data


@intrinsic
def _pointer(_: Any, address: Any) -> Any:
    """Turn an address into a pointer, so that compiled code can write to arrays that are no arguments."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@numba.njit(nogil=True)
def _counts() -> Any:
    return numba.carray(_pointer(COUNTS_AT), (7,), np.int64)


@numba.njit(nogil=True)
def _next(log: int) -> int:
    """Count a call and return the row to write to, -1 where there is no more room."""
    counts = _counts()
    counts[log] += 1
    return counts[log] - 1 if counts[log] <= CAPACITIES[log] else -1


@numba.njit(nogil=True)
def _links(T_parent_joint: Any, axis: Any, q: Any, out: Any) -> None:
    row = _next(JOINTS)
    if row >= 0:
        log = numba.carray(_pointer(JOINTS_AT), (CAPACITIES[JOINTS], WIDTHS[JOINTS]), np.float64)
        for joint in range(len(q)):
            log[row, joint] = q[joint]
    link_poses_into(T_parent_joint, axis, q, out)


@numba.njit(nogil=True)
def _centres(node: Any, carrier: Any, links: Any, out: Any) -> None:
    centres_into(node, carrier, links, out)
    row = _next(PLACED)
    if row >= 0:
        log = numba.carray(_pointer(PLACED_AT), (CAPACITIES[PLACED], WIDTHS[PLACED]), np.float64)
        for m in range(len(carrier)):
            for k in range(3):
                log[row, 3 * m + k] = out[m, k]


@numba.njit(nogil=True)
def _bounding(node: Any, real: Any, whole: Any, pair: Any, p: int, centres: Any) -> float:
    row = _next(BOUNDS)
    if row >= 0:
        log = numba.carray(_pointer(BOUNDS_AT), (CAPACITIES[BOUNDS], WIDTHS[BOUNDS]), np.float64)
        log[row, 0], log[row, 1] = p, _counts()[PLACED] - 1
    return bounding_gap(node, real, whole, pair, p, centres)


@numba.njit(nogil=True)
def _relative(poses: Any, link: int, other: int, out: Any) -> None:
    relative_into(poses, link, other, out)
    row = _next(FRAMES)
    if row >= 0:
        log = numba.carray(_pointer(FRAMES_AT), (CAPACITIES[FRAMES], WIDTHS[FRAMES]), np.float64)
        for k in range(16):
            log[row, k] = out[k // 4, k % 4]


@numba.njit(nogil=True)
def _compared(kind: int, a: int, b: int, wanted: float, clearance: float, F: Any, start: Any) -> None:
    """Record a comparison: its kind, of what, at which distances, the pose between, where the search starts."""
    row = _next(COMPARED)
    if row >= 0:
        log = numba.carray(_pointer(COMPARED_AT), (CAPACITIES[COMPARED], WIDTHS[COMPARED]), np.float64)
        log[row, 0], log[row, 1], log[row, 2], log[row, 3], log[row, 4] = kind, a, b, wanted, clearance
        for k in range(12):
            log[row, 5 + k] = F[k // 4, k % 4]
        for k in range(5):
            log[row, 17 + k] = start[k]


@numba.njit(nogil=True)
def _bodies(
    node: Any, child: Any, real: Any, whole: Any, lower: Any, upper: Any, hull_points: Any, hull_edge: Any,
    hull_real: Any, hull_whole: Any, pair: Any, p: int, F: Any, wanted: float, clearance: float, direction: Any,
    simplex: Any,
) -> Any:  # fmt: skip
    _compared(WHOLE_BODY, p, 0, wanted, clearance, F, direction[p])
    return compare_bodies(
        node, child, real, whole, lower, upper, hull_points, hull_edge, hull_real, hull_whole, pair, p, F, wanted,
        clearance, direction, simplex,
    )  # fmt: skip


@numba.njit(nogil=True)
def _hulls(
    points: Any, edge: Any, real: Any, whole: Any, a: int, b: int, F: Any, wanted: float, clearance: float,
    start: Any, room: Any,
) -> Any:  # fmt: skip
    _compared(HULLS, a, b, wanted, clearance, F, start)
    return convex_gap(points, edge, real, whole, a, b, F, wanted, clearance, start, room)


@numba.njit(nogil=True)
def _ball(node: Any, real: Any, whole: Any, lower: Any, upper: Any, ball: int, d: int, F: Any) -> Any:
    _compared(BALL, ball, d, 0.0, 0.0, F, np.zeros(5))
    return ball_bounds(node, real, whole, lower, upper, ball, d, F)


@numba.njit(nogil=True, error_model="numpy")
def _segments(tree: Any, contact: float, n: int, starts: Any, along: Any, near: Any, far: Any, hit: Any) -> None:
    batch = _next(BATCHES)
    batches = numba.carray(_pointer(BATCHES_AT), (CAPACITIES[BATCHES], WIDTHS[BATCHES]), np.float64)
    if batch >= 0:
        batches[batch, 0] = n
    rays = numba.carray(_pointer(RAYS_AT), (CAPACITIES[RAYS], WIDTHS[RAYS]), np.float64)
    for i in range(n):
        row = _next(RAYS)
        if row >= 0:
            for k in range(3):
                rays[row, k], rays[row, 3 + k] = starts[i, k], along[i, k]
    trace_segments(tree, contact, n, starts, along, near, far, hit)


def _recompiled(kernel: Any, **replaced: Any) -> Any:
    """Compile a kernel from its own code with other functions in the place of some that it calls."""
    plain = kernel.py_func
    if missing := set(replaced) - set(plain.__globals__):
        raise SystemExit(f"{plain.__name__} calls no {', '.join(sorted(missing))}: bring this benchmark up to date")
    options = {name: value for name, value in kernel.targetoptions.items() if name in ("nogil", "error_model")}
    copy = FunctionType(plain.__code__, {**plain.__globals__, **replaced}, plain.__name__)
    return numba.njit(**options)(copy)


TOOL_STATES = _recompiled(
    state_tests.tool_states, centres_into=_centres, bounding_gap=_bounding, compare_bodies=_bodies
)
WITNESSED = _recompiled(state_tests.witnessed, relative_into=_relative, convex_gap=_hulls, ball_bounds=_ball)
ARM_STATE = _recompiled(
    state_tests.arm_state,
    centres_into=_centres,
    bounding_gap=_bounding,
    relative_into=_relative,
    compare_bodies=_bodies,
)
STATE_PARTS = {"link_poses_into": _links, "arm_state": ARM_STATE, "witnessed": WITNESSED}
BRANCH_STATES = _recompiled(
    sweep_states._branch_states, **STATE_PARTS, _mark_blocked=_recompiled(sweep_states._mark_blocked, **STATE_PARTS)
)
CLASSIFY_SWEEP = _recompiled(sweep_states.classify_sweep, tool_states=TOOL_STATES, _branch_states=BRANCH_STATES)
FOLLOW_ROWS = _recompiled(sweep_pieces.follow_rows, classify_sweep=CLASSIFY_SWEEP)
MEASURE_KERNEL = _recompiled(measurability._measure_kernel, trace_segments=_segments)


@numba.njit(nogil=True)
def _joints_again(works: bool, T_parent_joint: Any, axis: Any, log: Any, n: int, links: Any) -> float:
    q, total = np.empty(len(axis)), 0.0
    for row in range(n):
        for joint in range(len(q)):
            q[joint] = log[row, joint]
        if works:
            link_poses_into(T_parent_joint, axis, q, links)
        total += q[0]
    return total


@numba.njit(nogil=True)
def _placed_again(works: bool, f: Any, n: int, links: Any) -> float:
    node, carrier = f[0], f[2]
    centres, total = np.zeros((len(carrier), 3)), 0.0
    for _ in range(n):  # the same arithmetic whatever the poses are
        if works:
            centres_into(node, carrier, links, centres)
        total += centres[0, 0]
    return total


@numba.njit(nogil=True)
def _bounds_again(works: bool, f: Any, log: Any, n: int, placed: Any) -> float:
    node, carrier, real, whole, pair = f[0], f[2], f[3], f[4], f[11]
    centres, before, total = np.empty((len(carrier), 3)), -1, 0.0
    for row in range(n):
        p, state = int(log[row, 0]), int(log[row, 1])
        if state != before:
            before = state
            for k in range(3 * len(carrier)):
                centres[k // 3, k % 3] = placed[state, k]
        total += bounding_gap(node, real, whole, pair, p, centres) if works else p + centres[0, 0]
    return total


@numba.njit(nogil=True)
def _frames_again(works: bool, log: Any, n: int) -> float:
    poses, out, total = np.empty((2, 4, 4)), np.zeros((4, 4)), 0.0
    poses[:] = np.eye(4)
    for row in range(n):
        for k in range(16):
            poses[1, k // 4, k % 4] = log[row, k]
        if works:
            relative_into(poses, 0, 1, out)
        total += out[0, 0] + poses[1, 0, 0]
    return total


@numba.njit(nogil=True)
def _comparisons_again(works: bool, f: Any, log: Any, n: int) -> float:
    node, child, _, real, whole, lower, upper, hull_points, hull_edge, hull_real, hull_whole, pair, _ = f
    direction, simplex, F = np.empty((max(len(pair), 1), 5)), np.empty((7, 4)), np.eye(4)
    total = 0.0
    for row in range(n):
        kind, a, b = int(log[row, 0]), int(log[row, 1]), int(log[row, 2])
        wanted, clearance = log[row, 3], log[row, 4]
        for k in range(12):
            F[k // 4, k % 4] = log[row, 5 + k]
        p = a if kind == WHOLE_BODY else 0
        for k in range(5):
            direction[p, k] = log[row, 17 + k]
        if not works:
            total += wanted + F[0, 0] + direction[p, 0]
        elif kind == WHOLE_BODY:
            total += compare_bodies(
                node, child, real, whole, lower, upper, hull_points, hull_edge, hull_real, hull_whole, pair, p, F,
                wanted, clearance, direction, simplex,
            )[1]  # fmt: skip
        elif kind == HULLS:
            total += convex_gap(
                hull_points, hull_edge, hull_real, hull_whole, a, b, F, wanted, clearance, direction[p], simplex
            )[0]
        else:
            total += ball_bounds(node, real, whole, lower, upper, a, b, F)[0]
    return total


@numba.njit(nogil=True, error_model="numpy")
def _rays_again(tree: Any, contact: float, starts: Any, along: Any, batches: Any, n: int, room: Any, hit: Any) -> None:
    begin = 0
    for batch in range(n):
        end = begin + int(batches[batch, 0])
        trace_segments(
            tree, contact, end - begin, starts[begin:end], along[begin:end], room[0, begin:end], room[1, begin:end],
            hit[begin:end],
        )  # fmt: skip
        begin = end


@dataclass
class Tally:
    """How many items each bare kernel worked on and its processor seconds."""

    count: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, count: int, work: Callable[..., Any], *arguments: Any) -> Any:
        """Do and time some work on this thread."""
        begun = time.thread_time()
        result = work(*arguments)
        spent = time.thread_time() - begun
        self.count[name] = self.count.get(name, 0) + count
        self.seconds[name] = self.seconds.get(name, 0.0) + spent
        return result

    def repeat(self, name: str, count: int, loop: Callable[..., Any], *arguments: Any) -> None:
        """Time a loop over recorded items less what the same loop takes without work."""
        loop(False, *arguments)  # from here on the recording is near the processor
        begun = time.thread_time()
        loop(False, *arguments)
        read = time.thread_time() - begun
        self.add(name, count, loop, True, *arguments)
        self.seconds[name] -= read

    @property
    def total_s(self) -> float:
        """Seconds of all kernels together."""
        return sum(self.seconds.values())

    def show(self) -> None:
        """Print a line a kernel and the sum."""
        for name, seconds in self.seconds.items():
            print(f"  {name:32s} {self.count[name]:12,d} {seconds:8.2f} s")
        print(f"  {'bare kernels together':45s} {self.total_s:8.2f} s")


def _again(tally: Tally, f: Any, T_parent_joint: Any, axis: Any) -> None:
    """Do again and time what the collision tests recorded, then forget it."""
    _check_room()
    links = np.tile(np.eye(4), (len(axis) + 1, 1, 1))
    n = COUNTS.tolist()
    tally.repeat("forward kinematics", n[JOINTS], _joints_again, T_parent_joint, axis, LOGS[JOINTS], n[JOINTS], links)
    tally.repeat("bounding balls placed", n[PLACED], _placed_again, f, n[PLACED], links)
    tally.repeat("bounding tests", n[BOUNDS], _bounds_again, f, LOGS[BOUNDS], n[BOUNDS], LOGS[PLACED])
    tally.repeat("poses between bodies", n[FRAMES], _frames_again, LOGS[FRAMES], n[FRAMES])
    tally.repeat("comparisons of hulls and balls", n[COMPARED], _comparisons_again, f, LOGS[COMPARED], n[COMPARED])
    COUNTS[:] = 0


def _check_room() -> None:
    if any(count > capacity for count, capacity in zip(COUNTS.tolist(), CAPACITIES)):
        raise SystemExit(f"a call recorded {COUNTS.tolist()} items, more than there is room for: {CAPACITIES}")


def _traced_again(tally: Tally, tree: Any, contact: float) -> None:
    _check_room()
    n_rays, n_batches = int(COUNTS[RAYS]), int(COUNTS[BATCHES])
    starts, along = (np.ascontiguousarray(LOGS[RAYS][:n_rays, part]) for part in (slice(0, 3), slice(3, 6)))
    room, hit = np.empty((2, n_rays)), np.empty(n_rays, np.int32)
    tally.add("rays cast", n_rays, _rays_again, tree, contact, starts, along, LOGS[BATCHES], n_batches, room, hit)
    COUNTS[:] = 0


@contextmanager
def recording(tally: Tally) -> Iterator[None]:
    """Let stages run on one core with recorders in their kernels; their results stay the same."""

    def measured(limits: Any, tree: Any, contact: float, *rest: Any) -> Any:
        found = MEASURE_KERNEL(limits, tree, contact, *rest)
        _traced_again(tally, tree, contact)
        return found

    def followed(f: Any, T_parent_joint: Any, axis: Any, *rest: Any) -> None:
        FOLLOW_ROWS(f, T_parent_joint, axis, *rest)
        _again(tally, f, T_parent_joint, axis)

    def classified(f: Any, T_parent_joint: Any, axis: Any, *rest: Any) -> None:
        CLASSIFY_SWEEP(f, T_parent_joint, axis, *rest)
        _again(tally, f, T_parent_joint, axis)

    solve, collides = parallel_axes.branches, Scene.collides

    def solved(geometry: Any, T: Any) -> Any:
        return tally.add("poses solved, all branches", len(T), solve, geometry, T)

    def checked(scene: Scene, q: Any) -> bool:
        return bool(tally.add("exact checks", 1, collides, scene, q))

    cores = os.sched_getaffinity(0)
    with ExitStack() as stack:
        stack.callback(os.sched_setaffinity, 0, cores)
        os.sched_setaffinity(0, {min(cores)})
        stack.enter_context(mock.patch.object(measurability, "_measure_kernel", measured))
        stack.enter_context(mock.patch.object(sweep_following, "follow_rows", followed))
        stack.enter_context(mock.patch.object(sweep_following, "classify_sweep", classified))
        stack.enter_context(mock.patch.object(sweep_following, "_POSES_PER_CHUNK", POSES_PER_CHUNK))
        stack.enter_context(mock.patch.object(parallel_axes, "branches", solved))
        stack.enter_context(mock.patch.object(Scene, "collides", checked))
        yield
