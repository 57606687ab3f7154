"""Sweeps that are passed at speed: the arm neither stops before them nor behind them, where a motion joins them.

A sweep from rest to rest spends its first and last millimetres getting to scanning speed. Where the motion between two
sweeps begins and ends with the velocities that the sweeps have at their ends, neither has to stop. Each option comes
timed in four ways, so that an end where no such motion was found still stops, and only that end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cellwright.cell.cell import Cell
from cellwright.solvers.path_timing import Limits, TimedMotion
from cellwright.solvers.stitched_plan import StitchSettings
from cellwright.solvers.sweeps.alternatives import AlternativeKey, PathKey, SweepSettings, options_by_ends
from cellwright.solvers.sweeps.planned import PlannedSweep

Ends = tuple[bool, bool]
"""Whether a motion is under way where it begins, and where it ends."""

STOPPING: Ends = (False, False)
PASSING: Ends = (True, True)
ALL_ENDS: tuple[Ends, ...] = (STOPPING, PASSING, (True, False), (False, True))


@dataclass(frozen=True, eq=False)
class PassedOption:
    """One way to execute a sweep: branch, winding and direction, timed for all ends.

    Attributes:
        sweep: Number of the sweep.
        alternative: What tells branch and winding from all others of the sweep.
        path: What tells the joint path, which windings and directions share.
        branch: Inverse kinematics branch.
        direction: 1 forwards, -1 backwards.
        motions: In the direction of execution, by what happens at its ends; `STOPPING` is always there. The last
            coordinate is the travel.
    """

    sweep: int
    alternative: AlternativeKey
    path: PathKey
    branch: int
    direction: int
    motions: dict[Ends, TimedMotion]

    @property
    def passes(self) -> bool:
        """Whether it can be passed at speed."""
        return all(ends in self.motions for ends in ALL_ENDS)


def passed_options(
    cell: Cell, sweeps: Sequence[PlannedSweep], settings: StitchSettings, *, at_speed: bool
) -> list[list[PassedOption]]:
    """Return the options of every sweep, timed for all ends, or for stops alone unless ``at_speed``."""
    chain = cell.robot.chain
    limits = Limits(chain.max_velocity, chain.max_acceleration)
    how = SweepSettings(limits, settings.scan_speed, settings.tool_acceleration, settings.sample, settings.trace_step)
    ends = ALL_ENDS if at_speed else (STOPPING,)
    return [_options(cell, sweep, number, how, settings.max_alternatives, ends) for number, sweep in enumerate(sweeps)]


def _options(
    cell: Cell, sweep: PlannedSweep, number: int, how: SweepSettings, count: int, ends: Sequence[Ends]
) -> list[PassedOption]:
    found = options_by_ends(cell, sweep, number, how, count, ends)
    motions: dict[tuple[AlternativeKey, int], dict[Ends, TimedMotion]] = {}
    for moving, options in found.items():
        for option in options:
            executed = moving if option.direction > 0 else (moving[1], moving[0])
            motions.setdefault((option.alternative, option.direction), {})[executed] = option.motion
    return [
        PassedOption(
            number, option.alternative, option.path, option.branch, option.direction,
            motions[option.alternative, option.direction],
        )
        for option in found[STOPPING]
    ]  # fmt: skip
