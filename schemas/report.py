"""The artefact that people read: one offline page and its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from schemas.artefact import Artefact
from schemas.columns import blob, fact


@dataclass(frozen=True, eq=False, repr=False)
class InspectionReport(Artefact):
    """The report of one inspection plan: self-contained HTML, the same figures as PNG, the summary as JSON."""

    KIND: ClassVar[str] = "inspection-report"

    page: bytes = blob("The report, one self-contained page", suffix=".html")
    cell_png: bytes = blob("The whole cell with the robot at its start", suffix=".png")
    coverage_png: bytes = blob("Coverage map on the part", suffix=".png")
    uncertainty_png: bytes = blob("Histogram of the predicted uncertainty", suffix=".png")
    plan_png: bytes = blob("The plan over time: joints and segments", suffix=".png")
    summary: str = fact("Figures of the plan as JSON", dtype="str")
