"""What a sequence run hands back: references, figures, and how to show them to a person."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from flows.run_record import StepRecord
from flows.run_result import RunResult, gathered
from flows.runner import Step
from schemas.sequence_summary import (
    acceleration_words,
    alternatives_words,
    bound_words,
    cost_label,
    distance_words,
    ordering_words,
)
from schemas.tasks import SequenceReport
from storage.lake import Lake

_MOST_SHOWN = 30


@dataclass(frozen=True, kw_only=True)
class SequenceResult(RunResult):
    """A verified sequence.

    Attributes:
        report: The report's artefact.
    """

    TITLE: ClassVar[str] = "Task sequence"

    report: SequenceReport

    @classmethod
    def of(
        cls, name: str, lake: Lake, run_id: str, steps: Mapping[str, Step], records: list[StepRecord]
    ) -> SequenceResult:
        """Gather the result of a finished run."""
        report = lake.load(steps["report"].ref())
        if not isinstance(report, SequenceReport):
            raise TypeError(f"the report is a {type(report).__name__}")
        return cls(**gathered(name, run_id, lake, steps, records), summary=json.loads(report.summary), report=report)

    def remarks(self) -> Iterable[str]:
        """Return the sequence, and what to mind of it."""
        names = self.summary["sequence"]
        more = f", and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
        yield f"Sequence: {', '.join(names[:_MOST_SHOWN])}{more}."
        yield from (f"Attention: {finding}." for finding in self.summary["attention"])

    def rows(self) -> list[tuple[str, str]]:
        """Return the summary as pairs of label and value."""
        figures = self.summary
        unit = figures["unit"]
        orders = [
            (f"{cost_label(figures)}: {name}", "a way has no motion" if cost is None else f"{cost:.2f} {unit}".strip())
            for name, cost in figures["orders"].items()
        ]
        return [
            ("tasks", f"{figures['tasks']}"),
            ("alternatives", alternatives_words(figures)),
            ("cycle time", f"{figures['duration_s']:.2f} s ({figures['moving_s']:.2f} s moving)"),
            *([("ordered by", ordered)] if (ordered := ordering_words(figures)) else []),
            *orders,
            ("lower bound", bound_words(figures)),
            ("motions planned", f"{figures['motions_planned']:,} of {figures['motions_possible']:,} by the search"),
            *([("greatest acceleration", fast)] if (fast := acceleration_words(figures)) else []),
            ("verified states", f"{figures['verified_states']:,} by {figures['verified_by']}"),
            ("least distance", distance_words(figures)),
        ]

    def pictures(self) -> dict[str, bytes]:
        """Return the report's figures as PNG bytes by name."""
        return {"path": self.report.path_png, "orders": self.report.orders_png, "plan": self.report.plan_png}
