"""What an inspection run hands back: references, figures, and how to show them to a person."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from flows.requests import InspectionRequest
from flows.run_record import StepRecord
from flows.run_result import RunResult, gathered
from flows.runner import Step
from schemas.inspection_summary import cover_words
from schemas.report import InspectionReport
from storage.lake import Lake


@dataclass(frozen=True, kw_only=True)
class InspectionResult(RunResult):
    """A verified plan.

    Attributes:
        report: The report's artefact.
    """

    TITLE: ClassVar[str] = "Inspection plan"

    report: InspectionReport

    @classmethod
    def of(
        cls, request: InspectionRequest, lake: Lake, run_id: str, steps: Mapping[str, Step], records: list[StepRecord]
    ) -> InspectionResult:
        """Gather the result of a finished run."""
        report = lake.load(steps["report"].ref())
        if not isinstance(report, InspectionReport):
            raise TypeError(f"the report is a {type(report).__name__}")
        facts = gathered(request.name, run_id, lake, steps, records)
        return cls(**facts, summary=json.loads(report.summary), report=report)

    def rows(self) -> list[tuple[str, str]]:
        """Return the summary as pairs of label and value."""
        figures = self.summary
        median = figures["uncertainty_median_m"]
        return [
            ("surface measured", f"{figures['coverage']:.2%}"),
            ("of what any sweep can measure", f"{figures['coverage_of_coverable']:.2%}"),
            ("candidate sweeps", f"{figures['candidates']:,}"),
            ("selected sweeps", f"{figures['sweeps']} ({cover_words(figures)}; greedy {figures['greedy_sweeps']})"),
            ("median uncertainty", "–" if median is None else f"{1e6 * median:.1f} µm"),
            ("cycle time", f"{figures['duration_s']:.2f} s ({figures['scanning_s']:.2f} s scanning)"),
            *([("placement", _placement_words(figures["placement"]))] if "placement" in figures else []),
            *([("sequence", _sequence_words(figures["sequencing"]))] if "sequencing" in figures else []),
            *((f"order: {name}", f"{seconds:.2f} s") for name, seconds in figures["orders_s"].items()),
            *([("order: lower bound", _order_words(figures))] if figures["order_lower_bound_s"] > 0.0 else []),
            ("scan points", f"{figures['scan_points']:,}"),
            ("verified states", f"{figures['verified_states']:,} by {figures['verified_by']}"),
            ("least distance", _distance_words(figures)),
            *(_overlap_row(overlap) for overlap in figures["overlaps"]),
            *([("sweeps left out", f"{len(figures['left_out_sweeps'])}")] if figures["left_out_sweeps"] else []),
        ]

    def remarks(self) -> Iterable[str]:
        """Return what the summary cannot say in figures."""
        missed = [f"{cause} {count:,}" for cause, count in self.summary["causes"].items()]
        if missed:
            yield f"Points not measured, by cause: {', '.join(missed)}."
        yield from (f"Part: {finding}" for finding in self.summary["findings"])
        yield from (f"Attention: {finding}." for finding in self.summary["attention"])
        yield from (f"Note: {note}." for note in self.summary["notes"])

    def coverage_rows(self) -> list[dict[str, Any]]:
        """Return the causes of missing coverage as table rows."""
        missed = [{"cause": cause, "points": count} for cause, count in self.summary["causes"].items()]
        return missed or [{"cause": "everything was measured", "points": 0}]

    def pictures(self) -> dict[str, bytes]:
        """Return the report's figures as PNG bytes by name."""
        return {
            "cell": self.report.cell_png,
            "coverage": self.report.coverage_png,
            "uncertainty": self.report.uncertainty_png,
            "plan": self.report.plan_png,
        }


def _order_words(figures: Mapping[str, Any]) -> str:
    proven = " (proven shortest)" if figures["order_proven_shortest"] else ""
    return f"{figures['order_lower_bound_s']:.2f} s over the connections found{proven}"


def _placement_words(placement: Mapping[str, Any]) -> str:
    before, after = placement["cycle_before_s"], placement["cycle_after_s"]
    if placement["refusal"]:
        return f"kept: {placement['reason']}"
    if not placement["moved"]:
        return f"kept, no better one of {placement['designs_judged']:,} judged"
    return f"{placement['moves']} moved, {placement['words']}: {before:.2f} s before ({after / before - 1.0:+.1%})"


def _sequence_words(sequencing: Mapping[str, Any]) -> str:
    by = "time" if sequencing["cost"] == "time" else "optimal control"
    if not sequencing["taken"]:
        return f"as stitched: {by} found none that costs less"
    stitched, found = (sequencing["plans"][sequencing[which]] for which in ("stitched", "name"))
    words = f"by {by}, cost {stitched['cost']:.2f} before, now {found['cost']:.2f}"
    if found["work_j"] is None or stitched["work_j"] is None:
        return words
    return f"{words}; work {stitched['work_j']:,.0f} J before, now {found['work_j']:,.0f} J"


def _overlap_row(overlap: Mapping[str, Any]) -> tuple[str, str]:
    return " and ".join(overlap["bodies"]), f"in one another by at least {1e3 * overlap['depth_at_least_m']:.1f} mm"


def _distance_words(figures: Mapping[str, Any]) -> str:
    found, proven = figures["least_distance_m"], figures["proven_distance_m"]
    if found is None:
        return "–"
    at_least = math.floor(1e5 * proven) / 100  # what is proven is rounded down
    return f"{1e3 * found:.2f} mm (proven {at_least:.2f}), {' and '.join(figures['nearest']['bodies'])}"
