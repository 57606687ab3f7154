"""Timed, collision-free motions between the ends of sweeps, found when asked for and remembered.

The straight joint motion if it is free, with its closed-form duration; else a path of the roadmap, shortened,
rounded and timed. Searching checks collisions in coarse steps; before a connection is used it is confirmed in
steps so small that no point of the robot moves further than a bound. If that fails it is sought again in steps
of a quarter.
"""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import SolverError
from cellwright.solvers.hermite import states_at
from cellwright.solvers.motion_steps import MovingCorners, dense_times
from cellwright.solvers.path_smoothing import round_corners, shorten
from cellwright.solvers.path_timing import Limits, TimedMotion, time_path, time_straight
from cellwright.solvers.roadmap import CollisionChecker, Roadmap

REFINEMENTS = 3
"""Times that the search step is cut to a quarter before a connection is given up."""


@dataclass(frozen=True)
class ConnectionSteps:
    """How finely `Connections` looks.

    Attributes:
        search: Largest joint turn between checked states while searching, rad.
        sample: Time between states, s.
        confirm, confirm_angle: Furthest motion of any point (m), largest joint turn (rad) while confirming.
        n_shortenings: Attempts to shorten a path.
    """

    search: float
    sample: float
    confirm: float
    confirm_angle: float
    n_shortenings: int = 20


@dataclass(frozen=True, eq=False)
class Connection:
    """A motion between two configurations and how it was found: ``direct`` or ``roadmap``."""

    motion: TimedMotion
    via: str


class Connections:
    """All connections asked for so far, in both directions.

    Where the roadmap has no way, one through ``hub`` (joints,) is tried if that is given: what can be reached from
    there and back is then connected with each other. With ``own_shortenings`` the random numbers that shorten a
    connection are its own: drawn from one number of ``rng`` and its two ends, whatever was planned before it.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        roadmap: Roadmap,
        corners: MovingCorners,
        limits: Limits,
        steps: ConnectionSteps,
        rng: np.random.Generator,
        *,
        hub: FloatArray | None = None,
        own_shortenings: bool = False,
    ) -> None:
        self._checker, self._roadmap, self._corners = checker, roadmap, corners
        self._limits, self._steps, self._rng, self._hub = limits, steps, rng, hub
        self._shortening_seed = int(rng.integers(2**63)) if own_shortenings else None
        self._found: dict[tuple[bytes, bytes], Connection | None] = {}
        self._confirmed: set[tuple[bytes, bytes]] = set()

    def duration(self, q_a: FloatArray, q_b: FloatArray) -> float:
        """Return the duration of the connection in s, infinite if none was found."""
        found = self._of(q_a, q_b)
        return np.inf if found is None else found.motion.duration

    def between(self, q_a: FloatArray, q_b: FloatArray) -> Connection | None:
        """Return the connection from ``q_a`` to ``q_b``, ``None`` if none was found."""
        found = self._of(q_a, q_b)
        if found is None or _key(q_a, q_b)[1]:
            return found
        return Connection(found.motion.reversed(), found.via)

    def confirm(self, q_a: FloatArray, q_b: FloatArray) -> bool:
        """Check the connection in small steps; return whether it was free, else replace it by another or none."""
        key, _ = _key(q_a, q_b)
        if key in self._confirmed:
            return True
        found = self._of(q_a, q_b)
        refinement = 0
        while found is not None and not self._is_free(found.motion):
            refinement += 1
            found = None
            if refinement <= REFINEMENTS:
                found = self._find(*_ordered(q_a, q_b), self._steps.search * 0.25**refinement)
        self._found[key] = found
        self._confirmed.add(key)
        return refinement == 0

    def forget_failures(self) -> None:
        """Seek again, when asked again, the connections that were not found: the roadmap knows more now."""
        missing = [key for key, found in self._found.items() if found is None]
        for key in missing:
            del self._found[key]
            self._confirmed.discard(key)

    def _is_free(self, motion: TimedMotion) -> bool:
        steps = self._steps
        return first_collision(self._checker, self._corners, motion, steps.confirm, steps.confirm_angle) is None

    def _of(self, q_a: FloatArray, q_b: FloatArray) -> Connection | None:
        key, _ = _key(q_a, q_b)
        if key not in self._found:
            self._found[key] = self._find(*_ordered(q_a, q_b), self._steps.search)
        return self._found[key]

    def _find(self, q_a: FloatArray, q_b: FloatArray, step: float) -> Connection | None:
        path = self._roadmap.connect(q_a, q_b, step)
        if path is None:
            path = self._through_hub(q_a, q_b, step)
        if path is None:
            return None
        sample = self._steps.sample
        if len(path) > 2:
            speed = self._limits.velocity
            rng = self._shortening_rng(q_a, q_b)
            path = shorten(path, speed, self._checker, rng, step=step, n_attempts=self._steps.n_shortenings)
        if len(path) == 2:
            return Connection(time_straight(q_a, q_b, self._limits, sample), "direct")
        try:
            motions = [
                time_straight(piece(piece.knots[:1])[0], piece(piece.knots[-1:])[0], self._limits, sample)
                if len(piece.control) == 1
                else time_path(piece, piece.grid(), self._limits, sample)
                for piece in round_corners(path, self._limits.velocity, self._checker, step=step)
            ]
        except SolverError:  # stopping at every corner always has a timing
            motions = [time_straight(a, b, self._limits, sample) for a, b in itertools.pairwise(path)]
        motion = motions[0]
        for following in motions[1:]:
            motion = motion.then(following)
        return Connection(motion, "roadmap")

    def _shortening_rng(self, q_a: FloatArray, q_b: FloatArray) -> np.random.Generator:
        if self._shortening_seed is None:
            return self._rng
        ends = hashlib.sha256(q_a.tobytes() + q_b.tobytes()).digest()
        return np.random.default_rng([self._shortening_seed, int.from_bytes(ends, "little")])

    def _through_hub(self, q_a: FloatArray, q_b: FloatArray, step: float) -> FloatArray | None:
        """Return a path that stops over at the hub, ``None`` if there is no hub or one end is not reached from it."""
        if self._hub is None or any(np.array_equal(q, self._hub) for q in (q_a, q_b)):
            return None
        there = self._roadmap.connect(q_a, self._hub, step)
        onward = None if there is None else self._roadmap.connect(self._hub, q_b, step)
        return None if there is None or onward is None else np.concatenate([there, onward[1:]])


def first_collision(
    checker: CollisionChecker, corners: MovingCorners, motion: TimedMotion, step: float, step_angle: float
) -> tuple[float, FloatArray] | None:
    """Return time and configuration of the first colliding state of a motion, ``None`` if it is free.

    No point of the robot moves further than ``step`` m, no joint turns more than ``step_angle`` rad between two
    checked states. Coordinates behind the joints are left out.
    """
    n_joints = corners.chain.n_joints
    joints = replace(motion, position=motion.position[:, :n_joints], velocity=motion.velocity[:, :n_joints])
    time = dense_times(joints, corners, step=step, step_angle=step_angle)
    position, _ = states_at(joints.time, joints.position, joints.velocity, time)
    row = checker.first_colliding(position)
    return None if row < 0 else (float(time[row]), position[row])


def _ordered(q_a: FloatArray, q_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    return (q_a, q_b) if _key(q_a, q_b)[1] else (q_b, q_a)


def _key(q_a: FloatArray, q_b: FloatArray) -> tuple[tuple[bytes, bytes], bool]:
    """Return one key for both directions, and whether this is the direction that is planned."""
    a, b = q_a.tobytes(), q_b.tobytes()
    forward = tuple(q_a.tolist()) <= tuple(q_b.tolist())
    return ((a, b) if forward else (b, a)), forward
