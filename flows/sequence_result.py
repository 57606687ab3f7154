"""What a sequence run hands back: references, figures, and how to show them to a person."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.run_record import StepRecord
from flows.runner import Step
from schemas.references import Ref
from schemas.sequence_summary import bound_words, distance_words
from schemas.tasks import SequenceReport
from storage.lake import Lake

if TYPE_CHECKING:
    from rich.console import Console

_MOST_SHOWN = 30


@dataclass(frozen=True)
class SequenceResult:
    """A verified sequence.

    Attributes:
        name: The cell's name.
        run_id: The run, as the lake has recorded it.
        refs: Its main artefacts by what they are.
        records: What became of each step.
        stage_seconds: Seconds that each step took when it was computed, now or in an earlier run.
        summary: The sequence's figures, units in the names.
        report: The report's artefact.
        files: Exported files by what they are.
    """

    name: str
    run_id: str
    refs: dict[str, Ref]
    records: list[StepRecord]
    stage_seconds: dict[str, float]
    summary: dict[str, Any]
    report: SequenceReport
    files: dict[str, Path] = field(default_factory=dict)

    @classmethod
    def of(
        cls, name: str, lake: Lake, run_id: str, steps: Mapping[str, Step], records: list[StepRecord]
    ) -> SequenceResult:
        """Gather the result of a finished run."""
        refs = {what: step.ref() for what, step in steps.items()}
        report = lake.load(refs["report"])
        if not isinstance(report, SequenceReport):
            raise TypeError(f"the report is a {type(report).__name__}")
        seconds = {
            record.name: float((lake.provenance(record.ref) or {}).get("seconds", record.seconds)) for record in records
        }
        return cls(name, run_id, refs, records, seconds, json.loads(report.summary), report)

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""
        return {
            "name": self.name,
            "run_id": self.run_id,
            "summary": self.summary,
            "artefacts": {name: {"kind": ref.kind, "digest": ref.digest} for name, ref in self.refs.items()},
            "steps": [record.as_json() for record in self.records],
            "files": {name: str(path) for name, path in self.files.items()},
        }

    def show(self, console: Console) -> None:
        """Print the summary table, the sequence and the paths."""
        from rich.table import Table

        table = Table(title=f"Task sequence: {self.name}", title_justify="left", show_header=False)
        table.add_column()
        table.add_column(justify="right")
        for label, value in self.rows():
            table.add_row(label, value)
        console.print(table)
        names = self.summary["sequence"]
        more = f", and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
        console.print(f"Sequence: {', '.join(names[:_MOST_SHOWN])}{more}.", soft_wrap=True)
        cached = sum(record.cached for record in self.records)
        console.print(f"Stages: {len(self.records) - cached} computed, {cached} from the lake.")
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True)

    def rows(self) -> list[tuple[str, str]]:
        """Return the summary as pairs of label and value."""
        figures = self.summary
        unit = figures["unit"]
        orders = [
            (f"cost: {name}", "a way has no motion" if cost is None else f"{cost:.2f} {unit}".strip())
            for name, cost in figures["orders"].items()
        ]
        return [
            ("tasks", f"{figures['tasks']}"),
            ("alternatives", f"{figures['alternatives']:,}"),
            ("cycle time", f"{figures['duration_s']:.2f} s ({figures['moving_s']:.2f} s moving)"),
            *orders,
            ("lower bound", bound_words(figures)),
            ("motions planned", f"{figures['motions_planned']:,} of {figures['motions_possible']:,}"),
            ("verified states", f"{figures['verified_states']:,} by {figures['verified_by']}"),
            ("least distance", distance_words(figures)),
        ]

    def as_markdown(self) -> str:
        """Return the summary for Prefect's user interface."""
        rows = "\n".join(f"| {label} | {value} |" for label, value in self.rows())
        return f"# {self.name}\n\n| | |\n|---|---:|\n{rows}\n"

    def pictures(self) -> dict[str, bytes]:
        """Return the report's figures as PNG bytes by name."""
        return {"path": self.report.path_png, "orders": self.report.orders_png, "plan": self.report.plan_png}
