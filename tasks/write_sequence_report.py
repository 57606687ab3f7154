"""Write the report of a sequence: one page that needs no network, its figures, its summary.

What belongs to one run (stage timings, lineage) is put at the ``<!--RUN-->`` mark when the page is exported.
"""

from __future__ import annotations

import base64
import hashlib
import json
from importlib import resources
from importlib.metadata import version
from typing import Any

from pydantic import Field

from schemas.motion import Verification
from schemas.params import Params
from schemas.sequence_summary import (
    acceleration_words,
    alternatives_words,
    bound_words,
    cost_label,
    distance_words,
    ordering_words,
    summarise_sequence,
)
from schemas.sources import CellModel
from schemas.stage import stage
from schemas.tasks import SequenceReport, TaskAlternatives, TaskList, TaskSequence

WEIGHTED = "optimal control"
"""The cost in which holding still costs torque and not time alone."""
ORDER_WORDS = {
    "as listed": "the tasks in the order of the file, each with the nearest alternative",
    "nearest next": "always the nearest task next, with its nearest alternative",
    "sequence": "the sequence that is planned",
}


class SequenceReportParams(Params):
    """Settings of the report of a sequence."""

    title: str = Field(default="Task sequence", description="Heading of the page.")
    notes: str = Field(default="", description="A remark shown below the heading.")
    template_sha256: str = Field(
        default="", description="Hash of the page's template and of what draws it, so that a change makes another page."
    )


def sequence_template_digest() -> str:
    """Return the SHA-256 (hex) of the page's template and of the versions of what draws the page."""
    drawn_by = {name: version(name) for name in ("jinja2", "matplotlib")}
    return hashlib.sha256(f"{_template()}\n{json.dumps(drawn_by, sort_keys=True)}".encode()).hexdigest()


@stage(version=6)
def write_sequence_report(
    cell: CellModel,
    tasks: TaskList,
    alternatives: TaskAlternatives,
    sequence: TaskSequence,
    verification: Verification,
    *,
    params: SequenceReportParams,
) -> SequenceReport:
    """Write the page, its figures and the summary of a verified sequence."""
    import jinja2

    from cellwright.figures.charts import plan_chart
    from cellwright.figures.tool_path import orders_chart, tool_path_picture
    from cellwright.solvers.motion_steps import link_poses_of
    from schemas.cell_objects import build_cell, known_torques

    summary = summarise_sequence(tasks, alternatives, sequence, verification)
    built = build_cell(cell)
    chain = built.robot.chain
    flange = built.T_world_base @ link_poses_of(chain, sequence.position_rad)[:, -1] @ chain.T_last_flange
    T_world_task = tasks.T_world_tool.reshape(-1, 4, 4)[sequence.task]
    path_png = tool_path_picture(built, (flange @ built.T_flange_scanner)[:, :3, 3], T_world_task)
    costs = dict(zip(sequence.order, sequence.order_cost.tolist(), strict=True))
    orders_png = orders_chart(
        costs, _parts(summary), sequence.lower_bound, sequence.unit, cost_label(summary), sequence.likely_bound
    )
    segments = [
        (float(begin), float(end), kind != "motion")
        for begin, end, kind in zip(sequence.start_s, sequence.end_s, sequence.kind, strict=True)
    ]
    plan_png = plan_chart(
        sequence.time_s, sequence.position_rad, sequence.velocity_rad_s, cell.max_velocity_rad_s, cell.joint, segments,
        marked="tasks", **known_torques(built, sequence.torque_nm),
    )  # fmt: skip
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(_template()).render(
        title=params.title,
        notes=params.notes,
        figures=summary,
        tiles=_tiles(summary),
        bound=bound_words(summary),
        distance=distance_words(summary),
        ordered=ordering_words(summary),
        cost_label=cost_label(summary),
        alternatives=alternatives_words(summary),
        stops=_stop_rows(tasks, alternatives, sequence),
        orders=_order_rows(summary),
        prices=_price_rows(summary),
        checks=_check_rows(verification),
        path_png=base64.b64encode(path_png).decode(),
        orders_png=base64.b64encode(orders_png).decode(),
        plan_png=base64.b64encode(plan_png).decode(),
    )
    told = json.dumps(summary, sort_keys=True, allow_nan=False)
    return SequenceReport(page.encode(), path_png, orders_png, plan_png, told)


def _template() -> str:
    return resources.files("tasks").joinpath("templates", "sequence_report.html.j2").read_text("utf-8")


def _parts(summary: dict[str, Any]) -> list[tuple[str, float]]:
    """Return the parts of the cost: what is no stroke and no dwell are motions, whatever they are counted by."""
    if summary["cost_of"] == WEIGHTED:
        return [
            ("motions", summary["weighted_travel"]),
            ("strokes", summary["weighted_strokes"]),
            ("holding still at tasks", summary["weighted_holding"]),
        ]
    work = summary["strokes_s"] + summary["dwell_s"]
    return [
        ("motions", max(0.0, summary["cost"] - work)),
        ("strokes", summary["strokes_s"]),
        ("dwells", summary["dwell_s"]),
    ]


def _tiles(summary: dict[str, Any]) -> list[dict[str, str]]:
    return [
        {"value": f"{summary['duration_s']:.2f} s", "label": "cycle time"},
        {"value": f"{summary['tasks']}", "label": "tasks"},
        {"value": f"{summary['alternatives']:,}", "label": "alternatives"},
        {"value": f"{summary['gap']:.1%}", "label": "gap to the lower bound"},
        {
            "value": f"{summary['motions_planned']:,}",
            "label": f"motions planned of {summary['motions_possible']:,}, by the search",
        },
        {"value": f"{summary['verified_states']:,}", "label": f"states verified by {summary['verified_by']}"},
    ]


def _stop_rows(tasks: TaskList, alternatives: TaskAlternatives, sequence: TaskSequence) -> list[dict[str, Any]]:
    counts = {row: int((alternatives.task == row).sum()) for row in range(len(tasks.name))}
    return [
        {
            "number": number + 1,
            "name": tasks.name[row],
            "place": ", ".join(f"{1e3 * x:.1f}" for x in tasks.T_world_tool[row].reshape(4, 4)[:3, 3]),
            "turn": f"{alternatives.rotation_rad[way] * 57.29577951308232:.0f}",
            "branch": int(alternatives.branch[way]) + 1,
            "count": counts[row],
            "arrive": f"{sequence.arrive_s[number]:.2f}",
            "dwell": f"{sequence.leave_s[number] - sequence.arrive_s[number]:.2f}",
        }
        for number, (row, way) in enumerate(zip(sequence.task.tolist(), sequence.alternative.tolist(), strict=True))
    ]


def _order_rows(summary: dict[str, Any]) -> list[dict[str, str]]:
    own = summary["cost"]
    return [
        {
            "name": name,
            "cost": "a way has no motion" if cost is None else f"{cost:.2f} {summary['unit']}".strip(),
            "more": "" if not cost or name == "sequence" else f"{100.0 * (1.0 - own / cost):.1f} % saved",
            "words": ORDER_WORDS.get(name, ""),
        }
        for name, cost in summary["orders"].items()
    ]


def _price_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return what time, torque and speed cost, and where, if dynamics count."""
    if "weighted_cost" not in summary:
        return []
    words = {
        "weighted_travel": "motions between tasks",
        "weighted_strokes": "strokes to and from tasks",
        "weighted_holding": "holding still at tasks",
        "weighted_time": "of all: time",
        "weighted_torque": "of all: squared torque",
        "weighted_speed": "of all: squared speed",
    }
    rows = [(label, f"{summary[name]:.2f}") for name, label in words.items()]
    fast = acceleration_words(summary)
    return [
        *rows,
        ("largest torque, share of its limit", f"{summary['torque_share']:.1%}"),
        *([("greatest acceleration", fast)] if fast else []),
    ]


def _check_rows(verification: Verification) -> list[dict[str, str]]:
    return [
        {
            "name": name,
            "found": f"{found:.3g}",
            "permitted": f"{'at least ' if least else 'at most '}{permitted:.3g}",
            "unit": unit,
        }
        for name, found, permitted, unit, least in zip(
            verification.check, verification.found, verification.permitted, verification.unit, verification.at_least,
            strict=True,
        )
    ]  # fmt: skip
