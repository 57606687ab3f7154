"""Write the report of an inspection plan: one page that needs no network, its figures, its summary.

The page holds everything that follows from the artefacts. What belongs to one run (stage timings, lineage) is put at
the ``<!--RUN-->`` mark when the page is exported, so that the artefact stays a function of its inputs.
"""

from __future__ import annotations

import base64
import hashlib
import json
from importlib import resources
from typing import Any

import numpy as np
from pydantic import Field

from cellwright.arrays import BoolArray, FloatArray
from cellwright.causes import Cause
from cellwright.cell.transforms import rotation_from_quaternion
from schemas.inspection_summary import blocking_bodies, summarise
from schemas.motion import ScanCloud, Trajectory, Verification
from schemas.params import Params
from schemas.part import PartMesh, SurfaceSamples
from schemas.report import InspectionReport
from schemas.sources import CellModel
from schemas.stage import stage
from schemas.views import Coverage, Viewpoints, ViewSelection

_CAUSE_WORDS = {
    Cause.NONE: "a scan point lies close enough",
    Cause.FIELD_OF_VIEW: "no candidate sweep has it inside the laser fan",
    Cause.INCIDENCE: "laser or detector look at it too flat, or from behind",
    Cause.UNCERTAINTY: "the predicted uncertainty exceeds the permitted one",
    Cause.EMITTER_OCCLUDED: "the part or the cell hides it from the laser",
    Cause.DETECTOR_OCCLUDED: "the part or the cell hides it from the detector",
    Cause.OUT_OF_REACH: "the robot has no inverse kinematics solution for the sweeps that see it",
    Cause.JOINT_LIMIT: "the sweeps that see it leave the joint limits",
    Cause.COLLISION: "the sweeps that see it collide",
    Cause.JOINT_SPEED: "a joint would be too slow for the scanning speed",
    Cause.TOO_SHORT: "the executable pieces of the sweeps that see it are too short",
    Cause.NOT_SELECTED: "a reachable sweep sees it, none of the selected ones (between samples, or beyond the goal)",
    Cause.NOT_SCANNED: "a selected sweep should see it, but no scan point came close enough",
}


_OFF_SURFACE = 0.002
"""How far the points of the 3D view stand off the surface, as a share of the part's diagonal."""


class ReportParams(Params):
    """Settings of the report."""

    title: str = Field(default="Inspection plan", description="Heading of the page.")
    notes: str = Field(default="", description="A remark shown below the heading.")
    max_uncertainty_m: float = Field(default=100e-6, gt=0, description="Permitted uncertainty, drawn as a line.")
    max_points: int = Field(default=20_000, ge=100, description="Most cloud points drawn in the 3D view.")
    template_sha256: str = Field(
        default="", description="Hash of the page's template, so that a changed template makes another page."
    )


def template_digest() -> str:
    """Return the SHA-256 (hex) of the page's template."""
    return hashlib.sha256(_template().encode()).hexdigest()


@stage(version=1)
def write_report(
    mesh: PartMesh,
    cell: CellModel,
    cloud: SurfaceSamples,
    coverage: Coverage,
    viewpoints: Viewpoints,
    selection: ViewSelection,
    trajectory: Trajectory,
    verification: Verification,
    scan: ScanCloud,
    *,
    params: ReportParams,
) -> InspectionReport:
    """Write the page, its figures and the summary of a verified plan; ``cloud`` is the verification cloud."""
    import jinja2

    from cellwright.figures.charts import plan_chart, uncertainty_histogram
    from cellwright.figures.coverage_map import coverage_picture

    spacing = 1.0 / np.sqrt(max(cloud.density_per_m2, 1e-9))
    summary = summarise(mesh, viewpoints, selection, trajectory, scan, coverage, verification)
    coverage_png = coverage_picture(
        mesh.vertices_m,
        mesh.faces,
        mesh.to_measure,
        cloud.points_m,
        cloud.normals,
        coverage.cause,
        spacing=spacing,
        two_sided=mesh.two_sided,
    )
    uncertainty_png = uncertainty_histogram(coverage.uncertainty_m, params.max_uncertainty_m)
    segments = [
        (begin, end, kind == "sweep")
        for begin, end, kind in zip(trajectory.start_s.tolist(), trajectory.end_s.tolist(), trajectory.kind)
    ]
    plan_png = plan_chart(
        trajectory.time_s,
        trajectory.position_rad,
        trajectory.velocity_rad_s,
        cell.max_velocity_rad_s,
        cell.joint,
        segments,
    )
    template = _template()
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(template).render(
        title=params.title,
        notes=params.notes,
        **_words(summary),
        tiles=_tiles(summary),
        causes=_cause_rows(coverage),
        sweeps=_sweep_rows(selection, trajectory),
        orders=_order_rows(trajectory),
        checks=_check_rows(verification),
        mesh=_mesh_facts(mesh),
        coverage_png=base64.b64encode(coverage_png).decode(),
        uncertainty_png=base64.b64encode(uncertainty_png).decode(),
        plan_png=base64.b64encode(plan_png).decode(),
        plotly_js=_trusted(_plotly_js()),
        scene_json=_trusted(_scene_json(mesh, cloud, coverage, viewpoints, trajectory, params.max_points)),
    )
    return InspectionReport(
        page.encode(), coverage_png, uncertainty_png, plan_png, json.dumps(summary, sort_keys=True, allow_nan=False)
    )


def _words(summary: dict[str, Any]) -> dict[str, str]:
    proof = (
        "proven to be the fewest possible"
        if summary["sweeps_proven_fewest"]
        else f"at least {int(np.ceil(summary['sweeps_lower_bound'] - 1e-6))} are needed"
    )
    orders = summary["orders_s"]
    saved = ""
    if {"greedy", summary["order"]} <= orders.keys() and summary["order"] != "greedy":
        saved = f" It saves {100 * (1 - orders[summary['order']] / orders['greedy']):.0f} % against the greedy order."
    return {
        "headline": f"{summary['sweeps']} sweeps measure {summary['coverage']:.2%} of the surface in "
        f"{summary['duration_s']:.1f} s.",
        "cover_words": f"Chosen from {summary['candidates']:,} candidates; {proof}. "
        f"The greedy choice takes {summary['greedy_sweeps']}.",
        "order_words": f"{summary['scanning_s']:.1f} s of {summary['duration_s']:.1f} s are spent scanning. "
        f"The sweeps run in the {summary['order']} order.{saved}",
        "verification_words": f"{summary['verified_states']:,} states of the whole motion were checked again by "
        f"{summary['verified_by']}, which did not plan it.",
    }


def _tiles(summary: dict[str, Any]) -> list[dict[str, str]]:
    return [
        {"value": f"{summary['coverage']:.2%}", "label": "of the surface measured"},
        {"value": f"{summary['coverage_of_coverable']:.2%}", "label": "of what any sweep can measure"},
        {"value": str(summary["sweeps"]), "label": f"sweeps of {summary['candidates']:,} candidates"},
        {"value": f"{summary['duration_s']:.1f} s", "label": "cycle time"},
        {"value": f"{_micrometres(summary['uncertainty_median_m'])} µm", "label": "median uncertainty"},
        {"value": f"{summary['scan_points']:,}", "label": "scan points"},
    ]


def _cause_rows(coverage: Coverage) -> list[dict[str, str]]:
    from cellwright.figures.coverage_map import CAUSE_COLOURS

    counts = np.bincount(coverage.cause, minlength=len(Cause))
    blockers = blocking_bodies(coverage)
    most = sorted(blockers, key=lambda name: -blockers[name])[:3]
    collided = f" with {', '.join(most)}" if most else ""
    return [
        {
            "colour": CAUSE_COLOURS[cause],
            "label": "measured" if cause is Cause.NONE else cause.label,
            "points": f"{counts[cause]:,}",
            "share": f"{counts[cause] / len(coverage.cause):.2%}",
            "words": _CAUSE_WORDS[cause] + (collided if cause is Cause.COLLISION else ""),
        }
        for cause in Cause
        if counts[cause]
    ]


def _sweep_rows(selection: ViewSelection, trajectory: Trajectory) -> list[dict[str, str]]:
    row_of = {int(view): row for row, view in enumerate(selection.view)}
    rows: list[dict[str, str]] = []
    for segment, kind in enumerate(trajectory.kind):
        if kind != "sweep":
            continue
        row = row_of[int(trajectory.view[segment])]
        travel = trajectory.travel_m[trajectory.segment == segment]
        rows.append(
            {
                "number": str(len(rows) + 1),
                "view": str(trajectory.view[segment]),
                "branch": str(trajectory.branch[segment]),
                "direction": "along x" if trajectory.direction[segment] > 0 else "against x",
                "start": f"{trajectory.start_s[segment]:.2f}",
                "duration": f"{trajectory.end_s[segment] - trajectory.start_s[segment]:.2f}",
                "length": f"{1e3 * (np.nanmax(travel) - np.nanmin(travel)):.0f}",
                "samples": str(selection.n_samples[row]),
                "only": str(selection.n_only[row]),
                "uncertainty": _micrometres(float(selection.max_uncertainty_m[row])),
            }
        )
    return rows


def _micrometres(length_m: float | None) -> str:
    return "–" if length_m is None or not np.isfinite(length_m) else f"{1e6 * length_m:.0f}"


def _order_rows(trajectory: Trajectory) -> list[dict[str, str]]:
    return [
        {"method": method, "duration": f"{duration:.2f}", "chosen": "this plan" if chosen else ""}
        for method, duration, chosen in zip(
            trajectory.order_method, trajectory.order_duration_s.tolist(), trajectory.order_chosen.tolist()
        )
    ]


def _check_rows(verification: Verification) -> list[dict[str, str]]:
    return [
        {"check": check, "found": f"{found:.4g}", "permitted": f"{permitted:.4g}", "unit": unit}
        for check, found, permitted, unit in zip(
            verification.check, verification.found.tolist(), verification.permitted.tolist(), verification.unit
        )
    ]


def _mesh_facts(mesh: PartMesh) -> dict[str, Any]:
    size = 1e3 * (mesh.vertices_m.max(axis=0) - mesh.vertices_m.min(axis=0))
    return {
        "faces": f"{len(mesh.faces):,}",
        "area": f"{1e4 * mesh.areas_m2.sum():.1f}",
        "area_to_measure": f"{1e4 * mesh.areas_m2[mesh.to_measure].sum():.1f}",
        "size": " × ".join(f"{edge:.1f}" for edge in size),
        "watertight": "yes" if mesh.watertight else "no",
        "findings": list(mesh.finding),
    }


def _scene_json(
    mesh: PartMesh,
    cloud: SurfaceSamples,
    coverage: Coverage,
    viewpoints: Viewpoints,
    trajectory: Trajectory,
    max_points: int,
) -> str:
    from cellwright.figures.coverage_map import CAUSE_COLOURS

    is_missed = coverage.cause != Cause.NONE
    # what was missed is drawn before what was measured, and neither beyond what a browser turns smoothly
    n_missed = min(int(is_missed.sum()), max_points // 2)
    stride_missed = -(-int(is_missed.sum()) // max(n_missed, 1))
    stride = -(-int((~is_missed).sum()) // (max_points - n_missed))
    # a hair off the surface, which would swallow half of every point otherwise
    off = _OFF_SURFACE * float(np.linalg.norm(np.ptp(mesh.vertices_m, axis=0)))
    shown = cloud.points_m + off * cloud.normals
    clouds = []
    for cause in Cause:
        of_cause: BoolArray = coverage.cause == cause
        if not of_cause.any():
            continue
        points = shown[of_cause][:: stride_missed if cause else stride]
        clouds.append(
            {
                "name": "measured" if cause is Cause.NONE else cause.label,
                "colour": CAUSE_COLOURS[cause],
                "missed": bool(cause),
                **_xyz(points),
            }
        )
    i, j, k = mesh.faces.T.tolist()
    scene = {
        "mesh": {**_xyz(mesh.vertices_m), "i": i, "j": j, "k": k},
        "clouds": clouds,
        "sweeps": _sweep_lines(viewpoints, trajectory),
    }
    return json.dumps(scene, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _sweep_lines(viewpoints: Viewpoints, trajectory: Trajectory) -> dict[str, list[Any]]:
    lines: dict[str, list[Any]] = {"x": [], "y": [], "z": [], "text": []}
    number = 0
    for segment, kind in enumerate(trajectory.kind):
        if kind != "sweep":
            continue
        number += 1
        view = int(trajectory.view[segment])
        travel = trajectory.travel_m[trajectory.segment == segment][[0, -1]]
        along = rotation_from_quaternion(viewpoints.quaternion[view])[:, 0]
        ends = viewpoints.position_m[view] + travel[:, None] * along
        for axis, values in _xyz(ends).items():
            lines[axis] += [*values, None]
        lines["text"] += [str(number), "", ""]
    return lines


def _xyz(points: FloatArray) -> dict[str, list[float]]:
    x, y, z = np.round(1e3 * points, 2).T.tolist()
    return {"x": x, "y": y, "z": z}


def _template() -> str:
    return resources.files("tasks").joinpath("templates/inspection_report.html.j2").read_text("utf-8")


def _plotly_js() -> str:
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _trusted(text: str) -> Any:
    """Mark our own script text as not to be escaped."""
    import markupsafe

    return markupsafe.Markup(text)  # plotly's own script, and JSON without "<"
