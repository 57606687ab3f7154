"""All ways in which the arm can execute a straight sweep: inverse kinematics branches, windings, directions.

A piece of a sweep is followed by Newton's method in small steps of travel, so that the joint path stays on its
branch; between the steps it is a cubic spline. Steps on which the spline would shake the scanner are halved, and a
timed motion that still does so has its states closer together or, if that is not enough, is slowed. A winding adds
whole turns to joints whose limits have room for them along the whole sweep; it moves as its branch does and collides
where its branch does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import track_pose
from cellwright.cell.inverse_kinematics import windings as configurations
from cellwright.cell.robot import Chain
from cellwright.cell.transforms import inverse
from cellwright.errors import SolverError
from cellwright.solvers.path_timing import Limits, TimedMotion, time_path
from cellwright.solvers.roadmap import travel_time
from cellwright.solvers.scanner_motion import REFINEMENTS, refined_trace, scanner_acceleration, steps_that_bend
from cellwright.solvers.sweeps.planned import PlannedSweep

TRACKING_TOLERANCE = 1e-8
"""Metres and rad: far below what is verified, far above rounding."""
TRACKING_STEPS = 20
LARGEST_TURN = 0.2
"""Rad of any joint between two traced poses; more means that the path has left its branch near a singularity."""
TURN = 2.0 * np.pi
FINER_TRACE = 0.25
"""Share of the step in which a sweep is traced again when no branch could be followed: near a singularity it helps."""

BEND_SHARE = 0.002
"""Share of the scanner's permitted acceleration that bends of the traced path may cause at full speed."""
SHAKE_TOLERANCE = 0.005
"""Share by which the scanner's acceleration may exceed its limit; half of what verification lets pass."""
CLOSER_STATES = (1.0, 0.5, 0.25)
"""Times between states that are tried, as shares of the usual one, before a sweep is slowed."""

PathKey = tuple[int, int]
"""Trace (0 in the usual steps, 1 in finer ones) and piece of the sweep."""
AlternativeKey = tuple[int, int, tuple[int, ...]]
"""Trace, piece, and whole turns of the joints."""


@dataclass(frozen=True, eq=False)
class SweepPath:
    """The joint path of one branch along a sweep.

    Attributes:
        branch: Inverse kinematics branch.
        travel: Travel of the traced poses, rising, (poses,) in m.
        position: Joint positions there, (poses, joints) in rad.
    """

    branch: int
    travel: FloatArray
    position: FloatArray

    def timed(
        self,
        limits: Limits,
        speed: float,
        acceleration: float,
        sample: float,
        moving: tuple[bool, bool] = (False, False),
    ) -> TimedMotion:
        """Time the sweep from rest to rest; the last coordinate of the motion is the travel in m.

        ``speed`` (m/s) and ``acceleration`` (m/s^2) bound the travel besides the joints' limits; with ``moving`` the
        first or the last pose is passed at speed.

        Raises:
            SolverError: If no timing was found.
        """
        from scipy.interpolate import CubicSpline

        path = CubicSpline(self.travel, np.column_stack([self.position, self.travel]))
        return time_path(path, self.travel, limits.with_travel(speed, acceleration), sample, moving)


@dataclass(frozen=True)
class SweepSettings:
    """How sweeps are traced and timed: limits of joints, speed and acceleration of the travel, SI units.

    ``sample`` is the time between states, ``trace_step`` the travel between traced poses, ``moving`` says which ends,
    forwards, are passed at speed.
    """

    limits: Limits
    speed: float
    acceleration: float
    sample: float
    trace_step: float
    moving: tuple[bool, bool] = (False, False)


@dataclass(frozen=True, eq=False)
class SweepOption:
    """One way to execute a sweep.

    Attributes:
        sweep: Number of the sweep.
        alternative: What tells branch and winding from all others of the sweep, however often it is traced.
        path: What tells the joint path, which windings share, from all others of the sweep.
        motion: The timed joint path, with the travel as last coordinate.
        branch: Inverse kinematics branch.
        direction: 1 forwards, -1 backwards.
    """

    sweep: int
    alternative: AlternativeKey
    path: PathKey
    motion: TimedMotion
    branch: int
    direction: int

    @property
    def entry(self) -> FloatArray:
        """Where it begins, (joints,) in rad."""
        return self.motion.position[0, :-1]

    @property
    def exit(self) -> FloatArray:
        """Where it ends, (joints,) in rad."""
        return self.motion.position[-1, :-1]


def sweep_options(
    cell: Cell, sweep: PlannedSweep, number: int, settings: SweepSettings, count: int
) -> list[SweepOption]:
    """Return up to ``count`` alternatives of a sweep, each forwards and then backwards; none if none can be timed."""
    return options_by_ends(cell, sweep, number, settings, count, (settings.moving,))[settings.moving]


def options_by_ends(
    cell: Cell,
    sweep: PlannedSweep,
    number: int,
    settings: SweepSettings,
    count: int,
    ends: Sequence[tuple[bool, bool]],
) -> dict[tuple[bool, bool], list[SweepOption]]:
    """Return the options of a sweep for each of ``ends``: which end of the forward motion is passed at speed.

    Of the options run backwards it is the other end. All are traced alike; the first of ``ends`` decides how finely.
    """
    for trace, step in enumerate((settings.trace_step, settings.trace_step * FINER_TRACE)):
        paths = {
            (trace, row): _straightened(cell, sweep, path, _largest_bend(sweep, settings))
            for row, piece in enumerate(sweep.pieces)
            if (
                path := trace_sweep(
                    cell, sweep.T_world_scanner, piece.q_start, piece.branch, piece.start, sweep.interval, step
                )
            )
        }
        if found := _timed_options(cell, paths, number, replace(settings, moving=ends[0]), count):
            others = {
                moving: _timed_options(cell, paths, number, replace(settings, moving=moving), count)
                for moving in ends[1:]
            }
            return {ends[0]: found, **others}
    return {moving: [] for moving in ends}


def _timed_options(
    cell: Cell, paths: dict[PathKey, SweepPath], number: int, settings: SweepSettings, count: int
) -> list[SweepOption]:
    keys = list(paths)
    chosen = nearest_windings(list(paths.values()), cell.robot.chain, np.array(cell.start, float), count)
    motions: dict[PathKey, TimedMotion] = {}
    for key in [keys[row] for row in sorted({row for row, _ in chosen})]:
        try:
            motions[key] = _steady_motion(cell, paths[key], settings)
        except SolverError:
            continue  # another branch may have a timing
    options = []
    for key, turns in ((keys[row], turns) for row, turns in chosen):
        if key in motions:
            base, branch = motions[key], paths[key].branch
            alternative = *key, tuple(int(turn) for turn in np.round(turns / TURN))
            wound = TimedMotion(base.time, base.position + np.append(turns, 0.0), base.velocity, base.acceleration)
            options.append(SweepOption(number, alternative, key, wound, branch, 1))
            options.append(SweepOption(number, alternative, key, wound.reversed(), branch, -1))
    return options


def _largest_bend(sweep: PlannedSweep, settings: SweepSettings) -> float:
    """Return the bend (1/m) of the scanner's line that takes its share of acceleration at the sweep's top speed."""
    first, last = sweep.interval
    top_square = min(settings.speed**2, settings.acceleration * (last - first))  # from rest to rest
    return BEND_SHARE * settings.acceleration / top_square


def _straightened(cell: Cell, sweep: PlannedSweep, path: SweepPath, largest_bend: float) -> SweepPath:
    """Return a path traced in finer steps where its spline bends the scanner's line by more (1/m), if it does."""
    from scipy.interpolate import CubicSpline

    for _ in range(REFINEMENTS):
        spline = CubicSpline(path.travel, path.position)
        middles = steps_that_bend(cell, spline, path.travel, largest_bend)
        if len(middles) == 0:
            break
        travel = np.sort(np.concatenate([path.travel, middles]))
        position = refined_trace(cell, flange_targets(cell, sweep.T_world_scanner, travel), spline(travel))
        if position is None:
            break
        path = SweepPath(path.branch, travel, position)
    return path


def _steady_motion(cell: Cell, path: SweepPath, settings: SweepSettings) -> TimedMotion:
    """Time a sweep so that the scanner itself, not only the travel, keeps its acceleration."""
    tried: list[tuple[float, TimedMotion]] = []
    for share in CLOSER_STATES:
        sample = share * settings.sample
        motion = path.timed(settings.limits, settings.speed, settings.acceleration, sample, settings.moving)
        joints = motion.of_first(path.position.shape[1])
        worst = float(scanner_acceleration(cell, joints).max()) / settings.acceleration
        if worst <= 1.0 + SHAKE_TOLERANCE:
            return motion
        tried.append((worst, motion))
    worst, motion = min(tried, key=lambda each: each[0])
    return motion.slowed(worst**0.5)


def flange_targets(cell: Cell, T_world_scanner: FloatArray, travel: FloatArray) -> FloatArray:
    """Return ``T_base_flange`` (n, 4, 4) with the scanner at each ``travel`` (n,) in m along its x axis.

    ``T_world_scanner`` (4, 4) is the scanner's pose at travel 0.
    """
    along = np.tile(np.eye(4), (len(travel), 1, 1))
    along[:, 0, 3] = travel
    T_base_scanner = inverse(cell.T_world_base) @ T_world_scanner
    return np.asarray(T_base_scanner @ along @ inverse(cell.T_flange_scanner))


def trace_sweep(
    cell: Cell,
    T_world_scanner: FloatArray,
    q_start: FloatArray,
    branch: int,
    start: float,
    interval: tuple[float, float],
    step: float,
) -> SweepPath | None:
    """Follow a sweep from ``q_start`` at travel ``start`` and return its path over ``interval``, all in m.

    ``start`` is at most the interval's first travel. ``None`` if a pose is not reached on the same branch,
    the first one from ``q_start`` included.
    """
    first, last = interval
    lead = np.linspace(start, first, int(np.ceil((first - start) / step)) + 1)[:-1] if first > start else np.empty(0)
    wanted = np.linspace(first, last, max(2, int(np.ceil((last - first) / step))) + 1)
    chain = cell.robot.chain
    targets = flange_targets(cell, T_world_scanner, np.concatenate([lead, wanted]))
    q, rows = np.ascontiguousarray(q_start, float), []
    for target in targets:
        following, reached = track_pose(
            chain.T_parent_joint, chain.axis, chain.T_last_flange, q, target, TRACKING_TOLERANCE, TRACKING_STEPS
        )
        if not reached or float(np.abs(following - q).max()) > LARGEST_TURN:
            return None
        q = following
        rows.append(q)
    return SweepPath(branch, wanted, np.stack(rows[len(lead) :]))


def windings(path: SweepPath, chain: Chain) -> FloatArray:
    """Return all turns (windings, joints) in rad that can be added to a path within the joint limits."""
    low, high = path.position.min(axis=0), path.position.max(axis=0)
    middle = 0.5 * (low + high)
    found = configurations(middle, chain.lower + (middle - low), chain.upper - (high - middle))
    return np.asarray(TURN * np.round((found - middle) / TURN))


def nearest_windings(
    paths: list[SweepPath], chain: Chain, q_near: FloatArray, count: int
) -> list[tuple[int, FloatArray]]:
    """Return up to ``count`` pairs of path number and turns whose middle lies nearest to ``q_near``.

    Nearness is the time of the slowest joint at full speed; ties go to the lower path and the lower turns.
    """
    found: list[tuple[float, int, tuple[float, ...]]] = []
    for number, path in enumerate(paths):
        middle = path.position[len(path.position) // 2]
        for turns in windings(path, chain):
            away = float(travel_time(middle + turns, q_near, chain.max_velocity))
            found.append((round(away, 9), number, tuple(turns.tolist())))
    return [(number, np.array(turns)) for _, number, turns in sorted(found)[:count]]
