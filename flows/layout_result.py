"""What a layout run hands back: references, figures, and how to show them to a person."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.run_record import StepRecord
from schemas.layout import LayoutReport
from schemas.references import Ref
from storage.lake import Lake

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class LayoutResult:
    """A layout that passed its gate, or an attempt that a study asked for.

    Attributes:
        name: The cell's name.
        run_id: The run, as the lake has recorded it.
        refs: Its main artefacts by what they are.
        records: What became of each step.
        stage_seconds: Seconds that each step took when it was computed, now or in an earlier run.
        cpu_s: Processor seconds of the optimisation when it was computed; `None` if the lake does not know.
        summary: The layout's figures, units in the names.
        report: The report's artefact; `None` for an attempt.
        files: Exported files by what they are.
    """

    name: str
    run_id: str
    refs: dict[str, Ref]
    records: list[StepRecord]
    stage_seconds: dict[str, float]
    cpu_s: float | None
    summary: dict[str, Any]
    report: LayoutReport | None
    files: dict[str, Path] = field(default_factory=dict)

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""
        return {
            "name": self.name,
            "run_id": self.run_id,
            "summary": self.summary,
            "cpu_s": self.cpu_s,
            "artefacts": {name: {"kind": ref.kind, "digest": ref.digest} for name, ref in self.refs.items()},
            "steps": [record.as_json() for record in self.records],
            "files": {name: str(path) for name, path in self.files.items()},
        }

    def show(self, console: Console) -> None:
        """Print the summary table, where everything stands, and the paths."""
        from rich.table import Table

        table = Table(title=f"Cell layout: {self.name}", title_justify="left", show_header=False)
        table.add_column()
        table.add_column(justify="right")
        for label, value in self.rows():
            table.add_row(label, value)
        console.print(table)
        cached = sum(record.cached for record in self.records)
        console.print(f"Stages: {len(self.records) - cached} computed, {cached} from the lake.")
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True)

    def rows(self) -> list[tuple[str, str]]:
        """Return the summary as pairs of label and value."""
        figures = self.summary
        before = figures["before_cycle_s"]
        gained = "" if before is None else f" ({1.0 - figures['cycle_s'] / before:.0%} shorter)"
        rows = [
            ("cycle time", f"{figures['cycle_s']:.3f} s"),
            ("before", "no cycle there" if before is None else f"{before:.3f} s{gained}"),
            ("starts that passed", f"{figures['starts_passed']} of {figures['starts']}"),
            ("of them the median, the worst", f"{figures['median_cycle_s']:.3f} s, {figures['worst_cycle_s']:.3f} s"),
            ("solver", figures["method"].replace("_", " ")),
        ]
        if self.cpu_s is not None:
            rows.append(("processor time", f"{self.cpu_s:.2f} s"))
        for name, T in figures["T_world_body"].items():
            rows.append((name, f"x {1e3 * T[0][3]:.0f}, y {1e3 * T[1][3]:.0f}, z {1e3 * T[2][3]:.0f} mm"))
        return rows

    def as_markdown(self) -> str:
        """Return the summary for Prefect's user interface."""
        rows = "\n".join(f"| {label} | {value} |" for label, value in self.rows())
        return f"# {self.name}\n\n| | |\n|---|---:|\n{rows}\n"

    def pictures(self) -> dict[str, bytes]:
        """Return the report's figures as PNG bytes by name."""
        if self.report is None:
            return {}
        return {
            "layout": self.report.layout_png,
            "motion": self.report.motion_png,
            "starts": self.report.starts_png,
        }

    def summary_file(self) -> bytes:
        """Return the result as the bytes of a JSON file."""
        plain = {name: value for name, value in self.as_json().items() if name != "files"}  # they lie beside it
        return json.dumps(plain, indent=2, sort_keys=True, allow_nan=False).encode() + b"\n"


def computing_seconds(lake: Lake, record: StepRecord) -> tuple[float, float | None]:
    """Return the seconds and processor seconds that a step took when it was computed."""
    provenance = lake.provenance(record.ref) or {}
    cpu = provenance.get("cpu_seconds")
    return float(provenance.get("seconds", record.seconds)), None if cpu is None else float(cpu)
