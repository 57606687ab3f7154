"""All ways in which the arm can perform each task: branches of inverse kinematics, free turns, windings.

Ways that collide, leave the joint limits or cannot follow the stroke are dropped, near duplicates merged; of the rest
those nearest to the start configuration are kept. A task that is left without any says what is in its way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.inverse_kinematics import InverseKinematics, inverse_kinematics_for, windings
from cellwright.errors import listed
from cellwright.solvers.path_timing import Limits
from cellwright.solvers.pose_tasks.strokes import time_stroke, trace_stroke
from cellwright.solvers.pose_tasks.task import PoseTask, Progress
from cellwright.solvers.roadmap import travel_time
from cellwright.solvers.sweeps.access import NamingChecker


@dataclass(frozen=True)
class AlternativeSettings:
    """How alternatives are made; SI units.

    Attributes:
        most: Alternatives kept of each task.
        same: Alternatives that differ by less in every joint are one, rad.
        sample: Time between states of a timed stroke.
    """

    most: int = 24
    same: float = 0.0175
    sample: float = 0.008


@dataclass(frozen=True, eq=False)
class Alternative:
    """One way to perform a task.

    Attributes:
        task: Row of the task.
        rotation: Turn about the tool's axis, rad.
        branch: Row that inverse kinematics gave it.
        q_task, q_entry: Configurations at the task's pose and retracted from it, (joints,) in rad.
        stroke: Time that one stroke takes, s.
    """

    task: int
    rotation: float
    branch: int
    q_task: FloatArray
    q_entry: FloatArray
    stroke: float


@dataclass
class Tally:
    """What became of a task's turns and solutions.

    ``blocked`` counts pairs of bodies that collide, ``n_left_out`` ways that were not tried as enough were kept.
    """

    n_rotations: int = 0
    n_reached: int = 0
    n_solutions: int = 0
    n_within_limits: int = 0
    n_broken: int = 0
    n_kept: int = 0
    n_left_out: int = 0
    blocked: Counter[tuple[str, str]] = field(default_factory=Counter)

    def reason(self, task: PoseTask, clearance: float) -> str:
        """Say why there is no alternative, and what mends it."""
        turns = f"{self.n_rotations} turns about the tool's axis" if self.n_rotations > 1 else "its only orientation"
        if not self.n_solutions:
            x, y, z = (1e3 * task.T_world_tool[:3, 3]).round(1).tolist()
            return f"out of reach in {turns}, at ({x:g}, {y:g}, {z:g}) mm: move it or the robot's base"
        if not self.n_within_limits:
            return f"all {self.n_solutions} solutions are outside the joint limits: widen them or move the base"
        if not self.blocked:
            return (
                f"the arm cannot follow its stroke of {1e3 * task.approach:g} mm on any of {self.n_broken} ways: "
                "shorten approach or move the base"
            )
        pairs = listed([f"{a} with {b} on {n}" for (a, b), n in self.blocked.most_common()], 3)
        near = f" (closer than {1e3 * clearance:g} mm)" if clearance > 0.0 else ""
        return (
            f"all {self.n_within_limits} solutions within the joint limits collide{near}: {pairs}: move the bodies, "
            "give more rotations, or name what touches at work in tool.touches"
        )


def task_alternatives(
    cell: Cell,
    tasks: Sequence[PoseTask],
    at_work: NamingChecker,
    on_the_way: NamingChecker,
    settings: AlternativeSettings,
    clearance: float = 0.0,
    progress: Progress = lambda share: None,
) -> tuple[list[Alternative], list[Tally]]:
    """Return the alternatives of all tasks, task by task, and what became of the rest.

    Args:
        cell: The cell; its ``T_flange_scanner`` is the pose of the tool point on the flange.
        tasks: The tasks.
        at_work: Scene by which strokes are checked, in which contacts of tool and work do not count.
        on_the_way: Scene by which the retracted end of strokes is checked.
        settings: How many are kept, and which are the same.
        clearance: Distance that the scenes keep, for messages.
        progress: Told the share of tasks done.
    """
    solver = inverse_kinematics_for(cell.robot.chain)
    found: list[Alternative] = []
    tallies: list[Tally] = []
    for row, task in enumerate(tasks):
        tally = Tally(n_rotations=task.n_rotations)
        own = _Ways(cell, row, task, at_work, on_the_way, settings, tally).kept(solver)
        tally.n_kept = len(own)
        found += own
        tallies.append(tally)
        progress((row + 1) / len(tasks))
    return found, tallies


class _Ways:
    """The ways to perform one task, tried from the nearest on."""

    def __init__(
        self,
        cell: Cell,
        row: int,
        task: PoseTask,
        at_work: NamingChecker,
        on_the_way: NamingChecker,
        settings: AlternativeSettings,
        tally: Tally,
    ) -> None:
        self.cell, self.row, self.task, self.tally, self.settings = cell, row, task, tally, settings
        self.at_work, self.on_the_way = at_work, on_the_way
        chain = cell.robot.chain
        self.limits = Limits(chain.max_velocity, chain.max_acceleration)
        self.free: dict[tuple[int, int], bool] = {}

    def kept(self, solver: InverseKinematics) -> list[Alternative]:
        """Return what is kept of all ways."""
        rotations = self.task.rotations()
        solutions = solver.solve(self.task.T_base_flange(self.cell, rotations))  # (rotations, branches, joints)
        kept: list[Alternative] = []
        candidates = self._candidates(solutions)
        for place, (_, turn, branch, q) in enumerate(candidates, 1):
            if any(float(np.abs(q - each.q_task).max()) < self.settings.same for each in kept):
                continue
            alternative = self._tried(turn, branch, float(rotations[turn]), q)
            if alternative is not None:
                kept.append(alternative)
            if len(kept) == self.settings.most:
                self.tally.n_left_out = self._others(candidates[place:], kept)
                break
        return kept

    def _others(self, candidates: list[tuple[float, int, int, FloatArray]], kept: list[Alternative]) -> int:
        """Return how many candidates are not known to collide, and are not among those kept."""
        left = [q for _, turn, branch, q in candidates if self.free.get((turn, branch), True)]
        if not left:
            return 0
        q = np.stack(left)
        known = np.zeros(len(q), bool)
        for each in kept:
            known |= np.abs(q - each.q_task).max(axis=1) < self.settings.same
        return int((~known).sum())

    def _candidates(self, solutions: FloatArray) -> list[tuple[float, int, int, FloatArray]]:
        """Return all ways within the joint limits, the nearest to the start first; ties go to the lower turn."""
        chain, tally = self.cell.robot.chain, self.tally
        solved = np.isfinite(solutions[:, :, 0])
        tally.n_reached, tally.n_solutions = int(solved.any(axis=1).sum()), int(solved.sum())
        found: list[tuple[float, int, int, FloatArray]] = []
        for turn, branch in np.argwhere(solved).tolist():
            wound = windings(solutions[turn, branch], chain.lower, chain.upper)
            tally.n_within_limits += bool(len(wound))
            away = np.round(travel_time(wound, self.cell.start, chain.max_velocity), 9)
            found += [(float(away[k]), turn, branch, wound[k]) for k in range(len(wound))]
        return sorted(found, key=lambda each: (*each[:3], each[3].tolist()))

    def _tried(self, turn: int, branch: int, rotation: float, q: FloatArray) -> Alternative | None:
        """Return the alternative at ``q`` if it is free; windings of one branch collide alike, so it is tried once."""
        if not self.free.get((turn, branch), True):
            return None
        path = trace_stroke(self.cell, self.task, rotation, q)
        if path is None:  # another winding may have room where this one has none
            self.tally.n_broken += 1
            return None
        if (turn, branch) not in self.free:
            pair = self._first_contact(path)
            self.free[turn, branch] = pair is None
            if pair is not None:
                self.tally.blocked[pair] += 1
                return None
        stroke = 0.0
        if len(path) > 1:
            motion = time_stroke(path, self.task.approach, self.limits, self.settings.sample)
            if motion is None:
                self.tally.n_broken += 1
                return None
            stroke = motion.duration
        return Alternative(self.row, rotation, branch, q, path[0], stroke)

    def _first_contact(self, path: FloatArray) -> tuple[str, str] | None:
        for q in path[::-1]:
            pair = self.at_work.colliding_pair(q)
            if pair is not None:
                return pair
        return self.on_the_way.colliding_pair(path[0])
