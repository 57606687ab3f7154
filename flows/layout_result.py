"""What a layout run hands back: references, figures, and how to show them to a person."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from flows.run_result import RunResult
from schemas.layout import LayoutReport


@dataclass(frozen=True, kw_only=True)
class LayoutResult(RunResult):
    """A layout that passed its gate, or an attempt that a study asked for.

    Attributes:
        cpu_s: Processor seconds of the optimisation when it was computed; `None` if the lake does not know.
        report: The report's artefact; `None` for an attempt.
    """

    TITLE: ClassVar[str] = "Cell layout"

    cpu_s: float | None
    report: LayoutReport | None

    def as_json(self) -> dict[str, Any]:
        """Return the result as plain values."""
        return {**super().as_json(), "cpu_s": self.cpu_s}

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
            (
                "joint limits kept",
                "speed and acceleration"
                if figures["accelerations_limited"]
                else "speed alone; acceleration too: solver.method second_order",
            ),
        ]
        if self.cpu_s is not None:
            rows.append(("processor time", f"{self.cpu_s:.2f} s"))
        for name, T in figures["T_world_body"].items():
            turn = math.degrees(math.atan2(T[1][0], T[0][0]))
            place = f"x {1e3 * T[0][3]:.0f}, y {1e3 * T[1][3]:.0f}, z {1e3 * T[2][3]:.0f} mm"
            rows.append((name, f"{place}, turned {turn:.1f} deg about z"))
        return rows

    def pictures(self) -> dict[str, bytes]:
        """Return the report's figures as PNG bytes by name."""
        if self.report is None:
            return {}
        return {
            "layout": self.report.layout_png,
            "motion": self.report.motion_png,
            "starts": self.report.starts_png,
        }
