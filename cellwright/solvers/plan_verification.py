"""Check a timed plan against everything it promises, with nothing of the planner but its result.

The motion is read as what it is, the cubic Hermite curve through its states. Limits are checked at its exact
extremes, at the stated values and by finite differences; scanner poses and collisions in steps so small that no
point of the robot moves further than a bound (`cellwright.solvers.motion_steps`). What lies between those steps is
proven free of contact by distances (`cellwright.solvers.clearance_proof`). Collisions and distances are left to the
engine that is handed in, which is not the planner's. Every check says what was found and what is permitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.cell.cell import Cell
from cellwright.cell.transforms import inverse
from cellwright.errors import InvalidInputError, UnsafePlanError, listed
from cellwright.solvers.clearance_proof import CONTACT, Clearance, PairChecker, prove_clearance
from cellwright.solvers.hermite import peak_acceleration, peak_velocity, position_extremes, states_at
from cellwright.solvers.motion_steps import MovingCorners, dense_times, link_poses_of
from cellwright.solvers.sweeps.planned import PlannedSweep

SAME_TIME = 1e-9
"""Seconds within which two times are one."""
STATES_PER_REPORT = 250
STATES_SHARE = 0.85
"""Share of the work that goes into the states; the rest goes into what lies between them."""
ACCELERATION_WINDOW = 8e-3
"""Seconds over which the scanner's acceleration is a mean: shorter ones would show rounding."""

MENDS = {
    "scanner acceleration on a sweep": "plan again with lower tool_acceleration_m_s2 or scan_speed_m_s, or with lower "
    "max_acceleration_rad_s2",
    "scanner speed on a sweep": "plan again with lower scan_speed_m_s",
    **dict.fromkeys(
        ("joint speed of the curve", "stated joint speed", "joint speed by differences"),
        "plan again with lower max_velocity_rad_s",
    ),
    **dict.fromkeys(
        ("joint acceleration of the curve", "stated joint acceleration", "joint acceleration by differences"),
        "plan again with lower max_acceleration_rad_s2",
    ),
    "joint torque": "carry less, or state the payload that the plan was made for",
    **dict.fromkeys(
        ("colliding states", "distance of bodies, between checked states too"), "plan again with more clearance_m"
    ),
    **dict.fromkeys(
        (
            "scanner off its planned line",
            "scanner turned off its planned orientation",
            "scanner turning during a sweep",
            "stated travel off the executed one",
        ),
        "plan again with lower scan_speed_m_s",
    ),
}
"""What can help when a check fails, by its name."""
MEND_OF_OTHERS = "no setting mends this, report it with the cell file"


class StateChecker(PairChecker, Protocol):
    """What verification asks of a collision engine."""

    def collision(self, q: FloatArray, /) -> tuple[str, str] | None:
        """Return the names of two bodies that touch at ``q`` (joints,) in rad, ``None`` if none do."""
        ...


@dataclass(frozen=True)
class Tolerances:
    """What a plan may deviate, SI units, and how finely it is looked at.

    Attributes:
        step, step_angle: Furthest that any point of the robot moves, any joint turns between checked states.
        limit_share: Share by which speed and acceleration limits may be exceeded.
        joint_angle: Joint angle in rad, and joint speed in rad/s, that counts as none.
        position, angle: Deviation of the scanner from its planned straight sweep.
    """

    step: float = 1e-3
    step_angle: float = np.deg2rad(0.1)
    limit_share: float = 0.01
    joint_angle: float = 1e-6
    position: float = 2e-4
    angle: float = np.deg2rad(0.05)


@dataclass(frozen=True, eq=False)
class ExecutedSegment:
    """One segment of the plan: the number of the planned sweep that it executes, -1 for a connection, and times."""

    sweep: int
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class TimedPlan:
    """The states of a plan; shapes (states,) and (states, joints), SI units; ``travel`` is NaN off the sweeps."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    segment: Int32Array
    travel: FloatArray
    segments: tuple[ExecutedSegment, ...]


@dataclass(frozen=True)
class Check:
    """One check: the worst value found, the permitted one, and where and when (s) the worst was found.

    What is permitted is the most; with ``at_least`` the least.
    """

    name: str
    found: float
    permitted: float
    unit: str
    where: str = ""
    at_least: bool = False
    time: float | None = None

    @property
    def passed(self) -> bool:
        """Whether what was found is permitted; not a number is not."""
        return self.found >= self.permitted if self.at_least else self.found <= self.permitted


def require(checks: Sequence[Check]) -> None:
    """Raise if a check has failed.

    Raises:
        UnsafePlanError: Naming the first failed check, where it failed and by how much.
    """
    failed = [check for check in checks if not check.passed]
    if not failed:
        return
    worst = failed[0]
    others = f"; {listed([check.name for check in failed[1:]])} failed too" if len(failed) > 1 else ""
    asked = "demanded" if worst.at_least else "permitted"
    unit = "" if worst.unit in worst.name else f" {worst.unit}"  # "colliding states is 1"
    raise UnsafePlanError(
        f"the plan fails its verification: {worst.name} is {worst.found:.6g}{unit} where "
        f"{worst.permitted:.6g}{unit} is {asked}{worst.where and ', ' + worst.where}{others}: "
        f"{MENDS.get(worst.name, MEND_OF_OTHERS)}, and do not run this plan",
        worst.time,
    )


def check_order(plan: TimedPlan) -> list[Check]:
    """Check that times rise, numbers are finite and segments follow each other without gaps.

    Raises:
        InvalidInputError: If the plan has fewer than two states or no segment.
    """
    if len(plan.time) < 2 or not plan.segments:
        raise InvalidInputError(
            f"the plan has {len(plan.time)} states and {len(plan.segments)} segments: nothing to run"
        )
    finite = np.isfinite(np.column_stack([plan.time, plan.position, plan.velocity, plan.acceleration])).all(axis=1)
    falls = np.append(~(np.diff(plan.time) > 0.0), False)
    bad = np.flatnonzero(~finite | falls)
    where = f"at state {bad[0]}, {plan.time[bad[0]]:.3f} s" if len(bad) else ""
    starts = np.array([segment.start for segment in plan.segments])
    ends = np.array([segment.end for segment in plan.segments])
    gaps = np.abs(np.concatenate([[starts[0] - plan.time[0]], starts[1:] - ends[:-1], [plan.time[-1] - ends[-1]]]))
    misplaced = ~np.isin(plan.segment, np.arange(len(starts)))
    of = np.where(misplaced, 0, plan.segment)
    outside = misplaced | (plan.time < starts[of] - SAME_TIME) | (plan.time > ends[of] + SAME_TIME)
    when = plan.time[outside]
    return [
        Check("states that are not finite or do not follow in time", float(len(bad)), 0.0, "states", where),
        Check("gap between segments", float(gaps.max()), SAME_TIME, "s", f"before segment {int(gaps.argmax())}"),
        Check("states outside their segment", float(outside.sum()), 0.0, "states", _at(when), time=_first(when)),
    ]


def check_limits(plan: TimedPlan, cell: Cell, tolerances: Tolerances, *, returns: bool = False) -> list[Check]:
    """Check start, rest, joint limits, speeds and accelerations: on the curve, as stated and by differences.

    With ``returns`` the plan must end where it starts.
    """
    chain, start = cell.robot.chain, np.asarray(cell.start)
    low, high = position_extremes(plan.time, plan.position, plan.velocity)
    beyond = np.maximum(chain.lower - low, high - chain.upper)
    dt = np.diff(plan.time)[:, None]
    jumps = np.abs(np.diff(plan.position, axis=0)) - chain.max_velocity * (1.0 + tolerances.limit_share) * dt
    jumps[np.diff(plan.segment) == 0] = -np.inf
    at_rest = np.abs(plan.velocity[[0, -1]])
    share = 1.0 + tolerances.limit_share
    speed, force = chain.max_velocity, chain.max_acceleration
    curve = (plan.time, plan.position, plan.velocity)
    shares = [
        ("joint speed of the curve", peak_velocity(*curve) / speed),
        ("stated joint speed", np.abs(plan.velocity) / speed),
        ("joint speed by differences", np.abs(np.diff(plan.position, axis=0)) / dt / speed),
        ("joint acceleration of the curve", peak_acceleration(*curve) / force),
        ("stated joint acceleration", np.abs(plan.acceleration) / force),
        ("joint acceleration by differences", np.abs(np.diff(plan.velocity, axis=0)) / dt / force),
    ]
    at_end = [
        Check("end off the start configuration", float(np.abs(plan.position[-1] - start).max()),
              tolerances.joint_angle, "rad", _at(plan.time[-1:])),
    ]  # fmt: skip
    return [
        Check("deviation from the start configuration", float(np.abs(plan.position[0] - start).max()),
              tolerances.joint_angle, "rad", "at 0.000 s"),
        *(at_end if returns else []),
        Check("joint speed at start and end", float(at_rest.max()), tolerances.joint_angle, "rad/s"),
        _worst("overshoot of a joint limit", beyond, tolerances.joint_angle, "rad", plan.time),
        _worst("jump between segments", np.maximum(jumps, 0.0), 0.0, "rad", plan.time),
        *(_worst(name, values, share, "of the limit", plan.time) for name, values in shares),
    ]  # fmt: skip


def check_sweeps(
    plan: TimedPlan,
    cell: Cell,
    sweeps: Sequence[PlannedSweep],
    max_speed: float,
    tolerances: Tolerances,
    *,
    max_acceleration: float = np.inf,
) -> list[Check]:
    """Check that every planned sweep is executed once, over its interval and no further, straight, without turning.

    Speed and acceleration of the scanner must stay within ``max_speed`` m/s and ``max_acceleration`` m/s^2.
    """
    executed = [segment.sweep for segment in plan.segments]
    missing = [sweep.name for number, sweep in enumerate(sweeps) if executed.count(number) == 0]
    repeated = [sweep.name for number, sweep in enumerate(sweeps) if executed.count(number) > 1]
    checks = [
        Check("sweeps not executed", float(len(missing)), 0.0, "sweeps", listed(missing)),
        Check("sweeps executed more than once", float(len(repeated)), 0.0, "sweeps", listed(repeated)),
    ]
    corners = MovingCorners.of(cell)
    limits = max_speed, max_acceleration
    worst: dict[str, Check] = {}
    for segment in plan.segments:
        if segment.sweep < 0:
            continue
        for check in _check_sweep(plan, segment, sweeps[segment.sweep], cell, corners, limits, tolerances):
            if check.name not in worst or not check.found <= worst[check.name].found:
                worst[check.name] = check
    return checks + list(worst.values())


@dataclass(frozen=True)
class CollisionProof:
    """What was found of collisions: the checks, the states checked, and how near bodies come if nothing collides."""

    checks: list[Check]
    n_states: int
    clearance: Clearance | None


def check_collisions(
    plan: TimedPlan,
    cell: Cell,
    checker: StateChecker,
    tolerances: Tolerances,
    progress: Callable[[float], None] = lambda share: None,
) -> CollisionProof:
    """Check the whole plan for collisions in small steps, then prove that none lies between them.

    It ends with the first collision.
    """
    corners = MovingCorners.of(cell)
    time = dense_times(plan, corners, step=tolerances.step, step_angle=tolerances.step_angle)
    position, _ = states_at(plan.time, plan.position, plan.velocity, time)
    moved = corners.displacement(position)
    turned = float(np.abs(np.diff(position, axis=0)).max())
    collisions, where, when = 0, "", None
    for number, q in enumerate(position):
        if number % STATES_PER_REPORT == 0:
            progress(STATES_SHARE * number / len(position))
        touching = checker.collision(q)
        if touching is not None:
            collisions, when = 1, float(time[number])
            where = f"{_at(time[number : number + 1])}: {touching[0]} touches {touching[1]}"
            break
    checks = [
        Check("colliding states", float(collisions), 0.0, "states", where, time=when),
        Check("motion between checked states", float(moved.max()), tolerances.step, "m"),
        Check("joint turn between checked states", turned, tolerances.step_angle, "rad"),
    ]
    clearance = None
    if collisions == 0:
        clearance = prove_clearance(
            plan,
            time,
            cell,
            checker,
            progress=lambda share: progress(STATES_SHARE + (1.0 - STATES_SHARE) * share),
        )
        where = f"at {clearance.time:.3f} s: {' and '.join(clearance.bodies)}"
        name = "distance of bodies, between checked states too"
        checks.append(Check(name, clearance.proven, CONTACT, "m", where, at_least=True, time=clearance.time))
    progress(1.0)
    return CollisionProof(checks, len(position), clearance)


def _check_sweep(
    plan: TimedPlan,
    segment: ExecutedSegment,
    sweep: PlannedSweep,
    cell: Cell,
    corners: MovingCorners,
    limits: tuple[float, float],
    tolerances: Tolerances,
) -> list[Check]:
    rows = np.flatnonzero((plan.time >= segment.start - SAME_TIME) & (plan.time <= segment.end + SAME_TIME))
    if len(rows) < 2:
        return [Check("sweep interval not executed", np.inf, tolerances.position, "m", sweep.name, time=segment.start)]
    part = slice(int(rows[0]), int(rows[-1]) + 1)
    motion = TimedPlan(
        plan.time[part], plan.position[part], plan.velocity[part], plan.acceleration[part],
        plan.segment[part], plan.travel[part], (),
    )  # fmt: skip
    time = dense_times(motion, corners, step=tolerances.step, step_angle=tolerances.step_angle)
    position, _ = states_at(motion.time, motion.position, motion.velocity, time)
    seen = _scanner_in_sweep(cell, sweep, position)
    travel, off = seen[:, 0, 3], np.linalg.norm(seen[:, 1:3, 3], axis=1)
    speed = np.linalg.norm(np.diff(seen[:, :3, 3], axis=0), axis=1) / np.diff(time)
    turned, swung = _angles(seen), _angles(inverse(seen[:1]) @ seen)
    stated = np.abs(_scanner_in_sweep(cell, sweep, motion.position)[:, 0, 3] - motion.travel)
    first, last = sweep.interval
    lacking = max(travel.min() - first, last - travel.max(), 0.0)
    beyond = np.maximum(np.maximum(first - travel, travel - last), 0.0)
    acceleration, windows = _scanner_acceleration(cell, sweep, motion)
    max_speed, max_acceleration = (limit * (1.0 + tolerances.limit_share) for limit in limits)
    where = f"in {sweep.name}"

    def worst(name: str, values: FloatArray, permitted: float, unit: str, times: FloatArray) -> Check:
        row = int(np.argmax(values))
        when = times[row : row + 1]
        return Check(name, float(values[row]), permitted, unit, f"{where} {_at(when)}", time=_first(when))

    return [
        worst("scanner off its planned line", off, tolerances.position, "m", time),
        worst("scanner turned off its planned orientation", turned, tolerances.angle, "rad", time),
        worst("scanner turning during a sweep", swung, tolerances.angle, "rad", time),
        worst("stated travel off the executed one", stated, tolerances.position, "m", motion.time),
        worst("travel beyond the sweep interval", beyond, tolerances.position, "m", time),
        worst("scanner speed on a sweep", speed, max_speed, "m/s", time),
        worst("scanner acceleration on a sweep", acceleration, max_acceleration, "m/s^2", windows),
        Check("sweep interval not executed", float(lacking), tolerances.position, "m", where, time=segment.start),
    ]


def _scanner_acceleration(cell: Cell, sweep: PlannedSweep, motion: TimedPlan) -> tuple[FloatArray, FloatArray]:
    """Return the scanner's mean accelerations (windows,) in m/s^2 over short windows, and when these start."""
    duration = float(motion.time[-1] - motion.time[0])
    time = np.linspace(motion.time[0], motion.time[-1], max(2, int(duration / ACCELERATION_WINDOW) + 1))
    position, rate = states_at(motion.time, motion.position, motion.velocity, time)
    dt = 1e-5  # central differences: 1e-10 off by the curvature, as much by rounding
    ahead, behind = (_scanner_in_sweep(cell, sweep, position + s * dt * rate)[:, :3, 3] for s in (1.0, -1.0))
    velocity = (ahead - behind) / (2.0 * dt)
    return np.linalg.norm(np.diff(velocity, axis=0), axis=1) / np.diff(time), time[:-1]


def _scanner_in_sweep(cell: Cell, sweep: PlannedSweep, position: FloatArray) -> FloatArray:
    """Return the scanner's poses in the frame of the sweep at travel 0, (states, 4, 4)."""
    chain = cell.robot.chain
    T_base_scanner = link_poses_of(chain, position)[:, -1] @ (chain.T_last_flange @ cell.T_flange_scanner)
    return np.asarray(inverse(sweep.T_world_scanner) @ cell.T_world_base @ T_base_scanner)


def _angles(T: FloatArray) -> FloatArray:
    """Return the rotation angles of poses (n, 4, 4); the sine keeps small angles exact."""
    R = T[:, :3, :3]
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    return np.asarray(np.arctan2(np.linalg.norm(axis, axis=1), np.trace(R, axis1=1, axis2=2) - 1.0))


def _worst(name: str, values: FloatArray, permitted: float, unit: str, time: FloatArray) -> Check:
    """Make a check of the largest of ``values`` (states or intervals, joints)."""
    row, joint = np.unravel_index(int(np.argmax(np.nan_to_num(values, nan=np.inf))), values.shape)
    where = f"{_at(time[row : row + 1])} in joint {int(joint) + 1}"
    return Check(name, float(values[row, joint]), permitted, unit, where, time=_first(time[row : row + 1]))


def _first(time: FloatArray) -> float | None:
    return float(time[0]) if len(time) else None


def _at(time: FloatArray) -> str:
    return f"at {float(time[0]):.3f} s" if len(time) else ""
