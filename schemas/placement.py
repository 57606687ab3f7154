"""Artefacts of the layout stage of an inspection: the placement that was found, and what it came to as a whole plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from cellwright.arrays import BoolArray, FloatArray, IntArray
from schemas.artefact import Artefact
from schemas.columns import ANY_WIDTH, blob, column, fact


@dataclass(frozen=True, eq=False, repr=False)
class Placement(Artefact):
    """Where part or robot's base should stand so that the selected sweeps take the shortest cycle.

    Where no better placement was found, the placement found is the one there was.
    """

    KIND: ClassVar[str] = "placement"

    joint: tuple[str, ...] = column("Design joint of the harness", dtype="str", table="joints")
    turns: BoolArray = column("Whether it turns (rad) or slides (m)", dtype="bool", table="joints")
    value: FloatArray = column("Where it stands, m or rad; zero is the cell file's placement", table="joints")
    lower: FloatArray = column("From where it moves, m or rad", table="joints")
    upper: FloatArray = column("To where it moves, m or rad", table="joints")
    carried: tuple[str, ...] = column("Body that moves along with the part", dtype="str", table="carried")
    T_world_part_before: FloatArray = column(
        "Pose of the part in the cell file's placement, rows of a 4x4 matrix", width=4, frame="world", table="before"
    )
    T_world_part: FloatArray = column(
        "Pose of the part in the placement found, rows of a 4x4 matrix", width=4, frame="world", table="after"
    )
    T_world_base_before: FloatArray = column(
        "Pose of the robot's base in the cell file's placement, rows of a 4x4 matrix",
        width=4,
        frame="world",
        table="before",
    )
    T_world_base: FloatArray = column(
        "Pose of the robot's base in the placement found, rows of a 4x4 matrix", width=4, frame="world", table="after"
    )
    T_world_motion: FloatArray = column(
        "Motion of what moves, in the world: T_after = T_world_motion T_before, rows of a 4x4 matrix",
        width=4,
        frame="world",
        table="after",
    )
    refused_test: tuple[str, ...] = column(
        "Test that refused designs: overlap, start collision or sweep", dtype="str", table="refused"
    )
    refused_what: tuple[str, ...] = column(
        "Bodies that overlap, body that the start meets, or sweep", dtype="str", table="refused"
    )
    refused_cause: tuple[str, ...] = column("Furthest test that the sweep reached", dtype="str", table="refused")
    refused_count: IntArray = column("Designs that it refused", dtype="int64", table="refused")
    trace_judged: IntArray = column(
        "Designs judged when the least estimated cycle improved", dtype="int64", table="trace"
    )
    trace_estimate_s: FloatArray = column("That estimate", unit="s", table="trace")
    trial_value: FloatArray = column("Design joints, m or rad", width=ANY_WIDTH, table="trials")
    trial_estimate_s: FloatArray = column("Estimated cycle of the design", unit="s", table="trials")
    trial_bound_s: FloatArray = column("Cycle that no plan there undercuts", unit="s", table="trials")
    trial_cycle_s: FloatArray = column("Its true cycle, stitched; infinite if refused", unit="s", table="trials")
    trial_reason: tuple[str, ...] = column("Why it was refused; empty if it was not", dtype="str", table="trials")
    trial_method: tuple[str, ...] = column("search, or gradient between sphere hulls", dtype="str", table="trials")
    gap_moved: tuple[str, ...] = column("Body that moves", dtype="str", table="gaps")
    gap_standing: tuple[str, ...] = column("Body that stands, or the robot's base", dtype="str", table="gaps")
    gap_m: FloatArray = column(
        "Their distance in the placement found is proven to be more, by their hulls; nothing is proven below zero",
        unit="m",
        table="gaps",
    )
    moves: str = fact("part or robot: what moves on the harness", dtype="str")
    is_better: bool = fact("Whether a better placement was found", dtype="bool")
    reason: str = fact("Why it is better, or why nothing is moved", dtype="str")
    cycle_before_s: float = fact("Cycle in the cell file's placement", unit="s")
    cycle_s: float = fact("Cycle in the placement found, as stitched while searching", unit="s")
    bound_before_s: float = fact(
        "Cycle that no plan of these sweeps undercuts in the cell file's placement; 0 where nothing was searched",
        unit="s",
    )
    n_judged: int = fact("Designs judged", dtype="int64")


@dataclass(frozen=True, eq=False, repr=False)
class PlacementOutcome(Artefact):
    """Both placements as whole plans, and which of them the inspection takes."""

    KIND: ClassVar[str] = "placement-outcome"

    joint: tuple[str, ...] = column("Design joint of the harness", dtype="str", table="joints")
    turns: BoolArray = column("Whether it turns (rad) or slides (m)", dtype="bool", table="joints")
    value: FloatArray = column("Where it stands in the plan, m or rad", table="joints")
    lower: FloatArray = column("From where it moves, m or rad", table="joints")
    upper: FloatArray = column("To where it moves, m or rad", table="joints")
    carried: tuple[str, ...] = column("Body that moves along with the part", dtype="str", table="carried")
    refused_test: tuple[str, ...] = column("Test that refused designs", dtype="str", table="refused")
    refused_what: tuple[str, ...] = column("Bodies or sweep", dtype="str", table="refused")
    refused_cause: tuple[str, ...] = column("Furthest test that the sweep reached", dtype="str", table="refused")
    refused_count: IntArray = column("Designs that it refused", dtype="int64", table="refused")
    moves: str = fact("part or robot: what moves on the harness", dtype="str")
    moved: bool = fact("Whether the plan is in the new placement", dtype="bool")
    reason: str = fact("Why, in words", dtype="str")
    refusal: str = fact(
        "Why a placement that looked better is not taken; empty if none did, or if it is taken", dtype="str"
    )
    cycle_before_s: float = fact("Cycle before", unit="s")
    cycle_after_s: float = fact("Cycle of the plan", unit="s")
    scanning_before_s: float = fact("Of it scanning, before", unit="s")
    scanning_after_s: float = fact("Of it scanning, in the plan", unit="s")
    coverage_before: float = fact("Share of the verification cloud that the scan measured before")
    coverage_after: float = fact("Share of the verification cloud that the plan's scan measures")
    n_judged: int = fact("Designs judged", dtype="int64")
    n_stitched: int = fact("Designs that were stitched into whole plans", dtype="int64")
    picture: bytes = blob(
        "Both placements from above with the way of the flange; empty if nothing moved", suffix=".png"
    )


def motion_words(joint: Sequence[str], turns: BoolArray, value: FloatArray) -> str:
    """Return a design in words: ``x -12.5 mm, yaw 30.0 deg``.

    >>> import numpy as np
    >>> motion_words(("x", "yaw"), np.array([False, True]), np.array([-0.0125, np.pi / 6]))
    'x -12.5 mm, yaw 30.0 deg'
    """
    return ", ".join(
        f"{name} {math.degrees(at):.1f} deg" if turning else f"{name} {1e3 * at:.1f} mm"
        for name, turning, at in zip(joint, turns.tolist(), value.tolist(), strict=True)
    )


def placement_figures(outcome: PlacementOutcome) -> dict[str, Any]:
    """Return what the summary of a plan says of its placement, as plain JSON values with units in the names."""
    return {
        "moves": outcome.moves,
        "moved": outcome.moved,
        "reason": outcome.reason,
        "refusal": outcome.refusal,
        "joints": {
            name: {"turn_rad" if turning else "slide_m": at}
            for name, turning, at in zip(outcome.joint, outcome.turns.tolist(), outcome.value.tolist())
        },
        "words": motion_words(outcome.joint, outcome.turns, outcome.value),
        "cycle_before_s": outcome.cycle_before_s,
        "cycle_after_s": outcome.cycle_after_s,
        "coverage_before": outcome.coverage_before,
        "coverage_after": outcome.coverage_after,
        "designs_judged": outcome.n_judged,
        "designs_stitched": outcome.n_stitched,
        "designs_refused": int(outcome.refused_count.sum()),
    }
