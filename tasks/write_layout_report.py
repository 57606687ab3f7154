"""Write the report of a layout: one page that needs no network, its figures, its summary.

What belongs to one run (processor times, stage timings) is put at the ``<!--RUN-->`` mark when the page is exported, so
that the artefact stays a function of its inputs.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from importlib import resources
from importlib.metadata import version
from typing import Any

import numpy as np
from pydantic import Field

from cellwright.errors import InfeasibleError
from schemas.layout import Layout, LayoutReport, RobotHull
from schemas.layout_objects import build_problem, drawn, drawn_before
from schemas.layout_params import LayoutProblemParams
from schemas.layout_summary import limits_accelerations, summary_of
from schemas.params import Params
from schemas.sources import SourceFile
from schemas.sphere_hull import SphereHull
from schemas.stage import stage


class LayoutReportParams(Params):
    """Settings of the report."""

    problem: LayoutProblemParams = Field(description="The problem that the layout solves.")
    title: str = Field(default="Cell layout", description="Heading of the page.")
    template_sha256: str = Field(
        default="",
        description="Hash of the page's template and of what draws it, so that a change makes another page.",
    )


def template_digest() -> str:
    """Return the SHA-256 (hex) of the page's template and of the versions of what draws the page."""
    drawn_by = {name: version(name) for name in ("jinja2", "matplotlib")}
    return hashlib.sha256(f"{_template()}\n{json.dumps(drawn_by, sort_keys=True)}".encode()).hexdigest()


@stage(version=3)
def write_layout_report(
    urdf: SourceFile | None,
    robot: RobotHull | None,
    hulls: SphereHull | None,
    layout: Layout,
    *,
    params: LayoutReportParams,
) -> LayoutReport:
    """Write the page, its figures and the summary of a layout.

    Raises:
        InfeasibleError: If the layout has not converged: it is no result.
    """
    import jinja2

    from cellwright.figures.layout_charts import layout_view
    from cellwright.figures.layout_motion import motion_chart, starts_chart

    if not layout.converged:
        raise InfeasibleError(f"there is no report of a layout that missed its gate: {layout.blocking}: relax that")
    problem = build_problem(params.problem, urdf, robot, hulls)
    had_cycle = math.isfinite(layout.before_cycle_s)
    before = f"before: {layout.before_cycle_s:.2f} s" if had_cycle else "before: no cycle"
    views = [(before, drawn_before(layout)), (f"after: {layout.cycle_s:.2f} s", drawn(layout))]
    figures = {
        "layout_png": layout_view(problem, views),
        "motion_png": motion_chart(
            _motions(layout), layout.joint, layout.joint_revolute, layout.joint_lower, layout.joint_upper
        ),
        "starts_png": starts_chart(layout.trial_cycle_s, layout.trial_converged, layout.before_cycle_s),
    }
    summary = summary_of(layout)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(_template()).render(
        zip=zip,
        title=params.title,
        layout=layout,
        accelerated=limits_accelerations(layout),
        tiles=_tiles(layout),
        design=_design_rows(layout),
        places=_place_rows(layout),
        gate=_gate_rows(layout),
        starts=_start_rows(layout),
        **{name: base64.b64encode(picture).decode() for name, picture in figures.items()},
    )
    return LayoutReport(page=page.encode(), summary=json.dumps(summary, sort_keys=True), **figures)


def _template() -> str:
    return resources.files("tasks").joinpath("templates/layout_report.html.j2").read_text("utf-8")


def _motions(layout: Layout) -> list[tuple[str, Any, Any]]:
    begins, found = 0.0, []
    for row, motion in enumerate(drawn(layout).transitions):
        title = f"{layout.start_visit[row]} → {layout.end_visit[row]}"
        at = np.linspace(0.0, motion.duration_s, 80)
        found.append((title, begins + at, motion.at(at)))
        begins += motion.duration_s
    return found


def _tiles(layout: Layout) -> list[dict[str, str]]:
    tiles = [("cycle time", f"{layout.cycle_s:.3f} s")]
    if math.isfinite(layout.before_cycle_s):
        tiles.append(("before", f"{layout.before_cycle_s:.3f} s"))
        tiles.append(("shorter by", f"{1.0 - layout.cycle_s / layout.before_cycle_s:.0%}"))
    if layout.approach_s > 0.0:
        tiles.append(("of it timed approaches", f"{layout.approach_s:.3f} s"))
    passed = int(layout.trial_converged.sum())
    tiles.append(("starts that passed their gate", f"{passed} of {len(layout.trial_converged)}"))
    tiles.append(("solver", layout.method.replace("_", " ")))
    return [{"label": label, "value": value} for label, value in tiles]


def _shown(value: float, turns: bool) -> str:
    return f"{math.degrees(value):.2f}°" if turns else f"{1e3 * value:.1f} mm"


def _design_rows(layout: Layout) -> list[dict[str, str]]:
    return [
        {
            "name": name,
            **{
                key: _shown(float(column[row]), bool(layout.revolute[row]))
                for key, column in (
                    ("lower", layout.lower),
                    ("upper", layout.upper),
                    ("before", layout.before),
                    ("value", layout.value),
                )
            },
        }
        for row, name in enumerate(layout.design)
    ]


def _place_rows(layout: Layout) -> list[dict[str, str]]:
    rows = []
    for name, matrix in zip(layout.body, layout.T_world_body):
        T = matrix.reshape(4, 4)
        yaw = math.degrees(math.atan2(T[1, 0], T[0, 0]))
        x, y, z = (f"{1e3 * value:.1f}" for value in T[:3, 3].tolist())
        rows.append({"name": name, "x": x, "y": y, "z": z, "yaw": f"{yaw:.2f}"})
    return rows


def _gate_rows(layout: Layout) -> list[dict[str, str]]:
    return [
        {
            "check": check,
            "found": f"{found:.3g}",
            "permitted": f"{permitted:.4g}",
            "unit": unit,
            "verdict": "passed" if limits_accelerations(layout) or "acceleration" not in check else "not asked for",
        }
        for check, found, permitted, unit in zip(
            layout.check, layout.found.tolist(), layout.permitted.tolist(), layout.unit
        )
    ]


def _start_rows(layout: Layout) -> list[dict[str, str]]:
    return [
        {
            "number": str(row),
            "cycle": f"{layout.trial_cycle_s[row]:.3f}",
            "cost": f"{layout.trial_extra_cost_s[row]:.3g}",
            "missed": f"{1e3 * layout.trial_endpoint_m[row]:.3g}",
            "iterations": str(layout.trial_iterations[row]),
            "verdict": "best" if row == layout.best_start else layout.trial_blocking[row] or "passed",
        }
        for row in range(len(layout.trial_cycle_s))
    ]
