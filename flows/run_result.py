"""What every run hands back: references, figures, and how to show them to a person.

A flow adds its own rows and remarks in a subclass; what the lake and Prefect are shown is the same for all.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from flows.run_record import StepRecord
from flows.runner import Step
from schemas.references import Ref
from storage.lake import Lake

if TYPE_CHECKING:
    from rich.console import Console

RUN_MARK = "<!--RUN-->"
"""Where a report's page takes what belongs to one run."""


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """The result of a finished run.

    Attributes:
        name: The cell's name.
        run_id: The run, as the lake has recorded it.
        refs: Its main artefacts by what they are.
        records: What became of each step.
        stage_seconds: Seconds that each step took when it was computed, now or in an earlier run.
        summary: The figures, units in the names.
        files: Exported files by what they are.
        notes: What a person should know of the run itself, a lake that keeps no record of it for one.
    """

    TITLE: ClassVar[str]
    """What stands above the summary."""

    name: str
    run_id: str
    refs: dict[str, Ref]
    records: list[StepRecord]
    stage_seconds: dict[str, float]
    summary: dict[str, Any]
    files: dict[str, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def rows(self) -> list[tuple[str, str]]:
        """Return the summary as pairs of label and value."""
        raise NotImplementedError

    def remarks(self) -> Iterable[str]:
        """Return the sentences that follow the summary."""
        return ()

    def pictures(self) -> dict[str, bytes]:
        """Return the report's figures as PNG bytes by name."""
        raise NotImplementedError

    def as_json(self) -> dict[str, Any]:
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

    def as_markdown(self) -> str:
        """Return the summary for Prefect's user interface."""
        rows = "\n".join(f"| {label} | {value} |" for label, value in self.rows())
        return f"# {self.name}\n\n| | |\n|---|---:|\n{rows}\n"

    def show(self, console: Console) -> None:
        """Print the summary table, the remarks and the paths."""
        from rich.table import Table

        table = Table(title=f"{self.TITLE}: {self.name}", title_justify="left", show_header=False)
        table.add_column()
        table.add_column(justify="right")
        for label, value in self.rows():
            table.add_row(label, value)
        console.print(table)
        for remark in self.remarks():
            console.print(remark, soft_wrap=True, markup=False)
        cached = sum(record.cached for record in self.records)
        console.print(f"Stages: {len(self.records) - cached} computed, {cached} from the lake.")
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True, markup=False)

    def summary_file(self) -> bytes:
        """Return the result as the bytes of a JSON file, for the folder in which the other files lie."""
        plain = {name: value for name, value in self.as_json().items() if name != "files"}
        return json.dumps(plain, indent=2, sort_keys=True, allow_nan=False).encode() + b"\n"

    def stages_section(self, remark: str = "") -> str:
        """Return the part of the report that belongs to one run, as HTML: how long each stage took."""
        rows = "".join(
            f"<tr><td>{html.escape(record.name)}</td><td>{self.stage_seconds[record.name]:.2f}</td>"
            f"<td>{'from the lake' if record.cached else 'computed'}</td><td>{record.version}</td>"
            f'<td class="words"><code>{record.ref.kind}/<wbr>{record.ref.digest[:12]}</code></td></tr>'
            for record in self.records
        )
        return (
            "<h2>Stages</h2><p class='lead'>Seconds that each stage took when it was computed, in this run or in an "
            f"earlier one; {sum(self.stage_seconds.values()):.1f} s together.{remark}</p><div class='card'><table>"
            "<tr><th>stage</th><th>seconds</th><th>in this run</th><th>version</th><th class='words'>artefact</th></tr>"
            f"{rows}</table></div>"
        )

    @property
    def run_line(self) -> str:
        """The report's last line, as HTML: which run it belongs to."""
        return f"<p class='lead'>Run {html.escape(self.run_id)}.</p>"


def gathered(
    name: str, run_id: str, lake: Lake, steps: Mapping[str, Step], records: Sequence[StepRecord]
) -> dict[str, Any]:
    """Return what a finished run tells of itself, whatever its flow: fields of `RunResult` by name."""
    return {
        "name": name,
        "run_id": run_id,
        "refs": {what: step.ref() for what, step in steps.items()},
        "records": list(records),
        "stage_seconds": {record.name: computing_seconds(lake, record)[0] for record in records},
    }


def computing_seconds(lake: Lake, record: StepRecord) -> tuple[float, float | None]:
    """Return the seconds and processor seconds that a step took when it was computed; `None` if unknown."""
    provenance = lake.provenance(record.ref) or {}
    cpu = provenance.get("cpu_seconds")
    return float(provenance.get("seconds", record.seconds)), None if cpu is None else float(cpu)
