"""What an inspection run hands back: references, figures, and how to show them to a person."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.requests import InspectionRequest
from flows.run_record import StepRecord
from flows.runner import Step
from schemas.inspection_summary import cover_words
from schemas.references import Ref
from schemas.report import InspectionReport
from storage.lake import Lake

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class InspectionResult:
    """A verified plan.

    Attributes:
        name: The cell's name.
        run_id: The run, as the lake has recorded it.
        refs: Its main artefacts by what they are.
        records: What became of each step.
        stage_seconds: Seconds that each step took when it was computed, now or in an earlier run.
        summary: The plan's figures, units in the names.
        report: The report's artefact.
        files: Exported files by what they are.
        notes: What a person should know of the run itself, a lake that keeps no record of it for one.
    """

    name: str
    run_id: str
    refs: dict[str, Ref]
    records: list[StepRecord]
    stage_seconds: dict[str, float]
    summary: dict[str, Any]
    report: InspectionReport
    files: dict[str, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, request: InspectionRequest, lake: Lake, run_id: str, steps: Mapping[str, Step], records: list[StepRecord]
    ) -> InspectionResult:
        """Gather the result of a finished run."""
        refs = {name: step.ref() for name, step in steps.items()}
        report = lake.load(refs["report"])
        if not isinstance(report, InspectionReport):
            raise TypeError(f"the report is a {type(report).__name__}")
        seconds = {record.name: _computing_seconds(lake, record) for record in records}
        return cls(request.name, run_id, refs, records, seconds, json.loads(report.summary), report)

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""
        return {
            "name": self.name,
            "run_id": self.run_id,
            "summary": self.summary,
            "artefacts": {name: {"kind": ref.kind, "digest": ref.digest} for name, ref in self.refs.items()},
            "steps": [record.as_json() for record in self.records],
            "files": {name: str(path) for name, path in self.files.items()},
            **({"notes": list(self.notes)} if self.notes else {}),
        }

    def show(self, console: Console) -> None:
        """Print the summary table and the paths."""
        from rich.table import Table

        table = Table(title=f"Inspection plan: {self.name}", title_justify="left", show_header=False)
        table.add_column()
        table.add_column(justify="right")
        for label, value in self.rows():
            table.add_row(label, value)
        console.print(table)
        missed = [f"{cause} {count:,}" for cause, count in self.summary["causes"].items()]
        if missed:
            console.print(f"Points not measured, by cause: {', '.join(missed)}.", soft_wrap=True)
        for finding in self.summary["findings"]:
            console.print(f"Part: {finding}", soft_wrap=True)
        for finding in self.summary["attention"]:
            console.print(f"Attention: {finding}.", soft_wrap=True, markup=False)
        for note in self.summary["notes"]:
            console.print(f"Note: {note}.", soft_wrap=True)
        cached = sum(record.cached for record in self.records)
        console.print(f"Stages: {len(self.records) - cached} computed, {cached} from the lake.")
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True)

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

    def as_markdown(self) -> str:
        """Return the summary for Prefect's user interface."""
        rows = "\n".join(f"| {label} | {value} |" for label, value in self.rows())
        return f"# {self.name}\n\n| | |\n|---|---:|\n{rows}\n"

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


def _computing_seconds(lake: Lake, record: StepRecord) -> float:
    provenance = lake.provenance(record.ref) or {}
    return float(provenance.get("seconds", record.seconds))
