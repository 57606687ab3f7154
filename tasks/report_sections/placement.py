"""The section of the inspection report on the placement: what moved, before and after, what was refused."""

from __future__ import annotations

import base64
import math
from importlib import resources
from typing import Any

from schemas.placement import PlacementOutcome

_MOST_ROWS = 8


def placement_template() -> str:
    """Return the text of the section's template."""
    return resources.files("tasks").joinpath("templates/placement_section.html.j2").read_text("utf-8")


def placement_section(outcome: PlacementOutcome) -> str:
    """Return the section as HTML."""
    import jinja2

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(placement_template()).render(
        lead=_lead(outcome),
        moved=outcome.moved,
        picture=base64.b64encode(outcome.picture).decode(),
        figures=_figure_rows(outcome),
        joints=_joint_rows(outcome),
        refused=_refused_rows(outcome),
        n_judged=f"{outcome.n_judged:,}",
        n_refused=f"{int(outcome.refused_count.sum()):,}",
        n_stitched=str(outcome.n_stitched),
    )


def _lead(outcome: PlacementOutcome) -> str:
    what = "The robot's base" if outcome.moves == "robot" else "The part"
    carried = f", with {', '.join(outcome.carried)}," if outcome.carried else ""
    if not outcome.moved:
        return f"{what} stays where the cell file puts it: {outcome.reason}."
    return (
        f"{what}{carried} is moved. Every sweep that was executed before is executed there, at least as far, and no "
        "less of the surface is measured. Sweeps were selected, and their samples counted, where the cell file puts "
        f"it; all else in this report is said of the new placement. {_upper(outcome.reason)}."
    )


def _upper(words: str) -> str:
    return words[:1].upper() + words[1:]


def _figure_rows(outcome: PlacementOutcome) -> list[dict[str, str]]:
    seconds = [
        ("cycle", outcome.cycle_before_s, outcome.cycle_after_s),
        ("of it scanning", outcome.scanning_before_s, outcome.scanning_after_s),
        (
            "of it between sweeps",
            outcome.cycle_before_s - outcome.scanning_before_s,
            outcome.cycle_after_s - outcome.scanning_after_s,
        ),
    ]
    rows = [
        {"what": what, "before": f"{old:.2f} s", "after": f"{new:.2f} s", "change": _change(old, new)}
        for what, old, new in seconds
    ]
    old, new = outcome.coverage_before, outcome.coverage_after
    rows.append({"what": "surface measured", "before": f"{old:.2%}", "after": f"{new:.2%}", "change": ""})
    return rows


def _change(before: float, after: float) -> str:
    return f"{100.0 * (after - before) / before:+.1f}%" if before > 0.0 else ""


def _joint_rows(outcome: PlacementOutcome) -> list[dict[str, str]]:
    rows = []
    for name, turns, value, lower, upper in zip(
        outcome.joint, outcome.turns.tolist(), outcome.value.tolist(), outcome.lower.tolist(), outcome.upper.tolist()
    ):
        unit, factor = ("°", 180.0 / math.pi) if turns else (" mm", 1e3)
        rows.append(
            {
                "joint": name,
                "value": f"{factor * value:.1f}{unit}",
                "range": f"{factor * lower:.0f} to {factor * upper:.0f}{unit}",
            }
        )
    return rows


def _refused_rows(outcome: PlacementOutcome) -> list[dict[str, Any]]:
    rows = [
        {"test": f"{test}: {cause}" if cause else test, "what": what, "count": f"{count:,}"}
        for test, what, cause, count in zip(
            outcome.refused_test, outcome.refused_what, outcome.refused_cause, outcome.refused_count.tolist()
        )
    ]
    rest = int(outcome.refused_count[_MOST_ROWS:].sum())
    return rows[:_MOST_ROWS] + ([{"test": "others", "what": "", "count": f"{rest:,}"}] if rest else [])
