"""Write the report of an inspection plan: one page that needs no network, its figures, its summary.

The page holds everything that follows from the artefacts. What belongs to one run (stage timings, lineage) is put at
the ``<!--RUN-->`` mark when the page is exported, so that the artefact stays a function of its inputs.
"""

from __future__ import annotations

import base64
import hashlib
import json
from importlib import resources
from importlib.metadata import version
from typing import Any

import numpy as np
from pydantic import Field

from cellwright.causes import Cause
from schemas.inspection_summary import blocking_bodies, cover_words, summarise
from schemas.motion import ScanCloud, Trajectory, Verification
from schemas.overlaps import StandingOverlaps
from schemas.params import Params
from schemas.part import PartMesh, SurfaceSamples
from schemas.placement import PlacementOutcome, placement_figures
from schemas.poses import Pose
from schemas.report import InspectionReport
from schemas.report_scene import scene_json
from schemas.scanner import ScannerParams
from schemas.sequencing import SweepSequence, sequencing_figures
from schemas.sources import CellModel
from schemas.sphere_hull import SphereHull
from schemas.stage import stage
from schemas.views import Coverage, Measurability, Reachability, Viewpoints, ViewSelection
from tasks.report_sections.hulls import hull_section, hull_template
from tasks.report_sections.placement import placement_section, placement_template
from tasks.report_sections.sequencing import sequencing_section, sequencing_template

CAUSE_WORDS = {
    Cause.NONE: "nothing: a point of the scan lies close enough",
    Cause.FIELD_OF_VIEW: "no candidate sweep has it inside the laser fan",
    Cause.INCIDENCE: "laser or detector look at it too flat, or from behind",
    Cause.UNCERTAINTY: "the predicted uncertainty exceeds the permitted one",
    Cause.EMITTER_OCCLUDED: "the part or the cell hides it from the laser",
    Cause.DETECTOR_OCCLUDED: "the part or the cell hides it from the detector",
    Cause.OUT_OF_REACH: "the arm cannot reach the poses of the sweeps that see it (no inverse kinematics solution)",
    Cause.JOINT_LIMIT: "the sweeps that see it leave the joint limits",
    Cause.COLLISION: "the sweeps that see it collide",
    Cause.JOINT_SPEED: "a joint would be too slow for the scanning speed",
    Cause.TOO_SHORT: "the executable pieces of the sweeps that see it are too short",
    Cause.NOT_SELECTED: "a reachable sweep sees it, none of the selected ones (between samples, or beyond the goal)",
    Cause.NOT_SCANNED: "a selected sweep should see it, but no scan point came close enough",
    Cause.NOT_CONNECTED: "only sweeps see it that the plan leaves out, as no way leads to them without collision",
}
"""What stopped a point, in words for a person."""


class ReportParams(Params):
    """Settings of the report."""

    title: str = Field(default="Inspection plan", description="Heading of the page.")
    notes: str = Field(default="", description="A remark shown below the heading.")
    max_uncertainty_m: float = Field(default=100e-6, gt=0, description="Permitted uncertainty, drawn as a line.")
    T_world_part: Pose = Field(
        default=Pose(), description="Pose of the part in the world, for the picture of the cell."
    )
    scanner: ScannerParams = Field(default=ScannerParams(), description="The scanner whose laser fan is drawn.")
    max_points: int = Field(default=20_000, ge=100, description="Most cloud points drawn in the 3D view.")
    template_sha256: str = Field(
        default="",
        description="Hash of the page's template and of what draws it, so that a change makes another page.",
    )


def template_digest() -> str:
    """Return the SHA-256 (hex) of the page's template and of the versions of what draws the page.

    Part of the parameters, so that an upgraded template, viewer or chart library makes another page.
    """
    drawn_by = {name: version(name) for name in ("jinja2", "matplotlib", "plotly")}
    sections = placement_template(), hull_template(), sequencing_template()
    texts = _template(), *sections, json.dumps(drawn_by, sort_keys=True)
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


@stage(version=8)
def write_report(
    mesh: PartMesh,
    cell: CellModel,
    cloud: SurfaceSamples,
    overlaps: StandingOverlaps,
    coverage: Coverage,
    viewpoints: Viewpoints,
    reachability: Reachability,
    measurability: Measurability,
    selection: ViewSelection,
    trajectory: Trajectory,
    verification: Verification,
    scan: ScanCloud,
    placement: PlacementOutcome | None = None,
    sequence: SweepSequence | None = None,
    part_hull: SphereHull | None = None,
    cell_hull: SphereHull | None = None,
    *,
    params: ReportParams,
) -> InspectionReport:
    """Write the page, its figures and the summary of a verified plan.

    ``cloud`` is the verification cloud, ``measurability`` what the selection was made from, ``placement`` whether
    part or robot was moved, the hulls what it was optimised with, ``sequence`` whether the sweeps were sequenced anew.
    """
    import jinja2

    from cellwright.figures.cell_view import cell_picture
    from cellwright.figures.charts import plan_chart, uncertainty_histogram
    from cellwright.figures.coverage_map import coverage_picture
    from schemas.cell_objects import build_cell, known_torques

    spacing = 1.0 / np.sqrt(max(cloud.density_per_m2, 1e-9))
    summary = summarise(
        mesh,
        viewpoints,
        measurability,
        selection,
        trajectory,
        scan,
        coverage,
        verification,
        overlaps=overlaps,
        reachability=reachability,
    )
    if placement is not None:
        summary["placement"] = placement_figures(placement)
    if sequence is not None:
        summary["sequencing"] = sequencing_figures(sequence)
    built = build_cell(cell, mesh, params.T_world_part.matrix())
    cell_png = cell_picture(built, params.scanner.scanner())
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
        **known_torques(built, trajectory.torque_nm),
    )
    template = _template()
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(template).render(
        title=params.title,
        notes=params.notes,
        **_words(summary, verification),
        tiles=_tiles(summary),
        attention=summary["attention"],
        remarks=summary["notes"],
        causes=_cause_rows(coverage),
        sweeps=_sweep_rows(selection, trajectory),
        orders=_order_rows(trajectory),
        checks=_check_rows(verification),
        mesh=_mesh_facts(mesh),
        permitted_um=round(1e6 * params.max_uncertainty_m, 3),
        cell_png=base64.b64encode(cell_png).decode(),
        coverage_png=base64.b64encode(coverage_png).decode(),
        uncertainty_png=base64.b64encode(uncertainty_png).decode(),
        plan_png=base64.b64encode(plan_png).decode(),
        placement_section=_trusted(
            (placement_section(placement) if placement else "") + hull_section(mesh, part_hull, cell_hull)
        ),
        sequencing_section=_trusted(sequencing_section(sequence) if sequence else ""),
        plotly_js=_trusted(_plotly_js()),
        scene_json=_trusted(scene_json(mesh, cloud, coverage, viewpoints, trajectory, params.max_points)),
    )
    return InspectionReport(
        page.encode(),
        cell_png,
        coverage_png,
        uncertainty_png,
        plan_png,
        json.dumps(summary, sort_keys=True, allow_nan=False),
    )


def _words(summary: dict[str, Any], verification: Verification) -> dict[str, str]:
    orders = summary["orders_s"]
    saved = ""
    if {"greedy", summary["order"]} <= orders.keys() and summary["order"] != "greedy":
        saved = f" It saves {100 * (1 - orders[summary['order']] / orders['greedy']):.0f}% against the greedy order."
    if summary["order_proven_shortest"]:
        saved += " No other order of these sweeps over the connections that were found is shorter: that is proven."
    elif summary["order_lower_bound_s"] > 0.0:
        saved += (
            f" Over the connections that were found no order of these sweeps takes less than "
            f"{summary['order_lower_bound_s']:.1f} s."
        )
    shares = [most for most, unit in zip(verification.permitted.tolist(), verification.unit) if unit == "of the limit"]
    excess = (
        f" Speeds and accelerations count as kept up to {max(shares) - 1:.0%} above their limits." if shares else ""
    )
    apart = ""
    if summary["least_distance_m"] is not None:
        one, other = summary["nearest"]["bodies"]
        apart = (
            f" Bodies come as near as {_millimetres(summary['least_distance_m'])} mm ({one} and {other} at "
            f"{summary['nearest']['time_s']:.2f} s); nowhere, between the checked states neither, do they come nearer "
            f"than {_millimetres(summary['proven_distance_m'], up=False)} mm, which is proven."
        )
    return {
        "headline": f"{summary['executed_sweeps']} sweeps measure {summary['coverage']:.2%} of the surface in "
        f"{summary['duration_s']:.1f} s.",
        "cover_words": f"Chosen from {summary['candidates']:,} candidates; {cover_words(summary)}. "
        f"The greedy choice takes {summary['greedy_sweeps']}.",
        "order_words": f"{summary['scanning_s']:.1f} s of {summary['duration_s']:.1f} s are spent scanning. "
        f"The sweeps run in the {summary['order']} order.{saved}",
        "verification_words": f"{summary['verified_states']:,} states of the whole motion were checked again by "
        f"{summary['verified_by']}, which did not plan it.{apart}{excess} Bodies that stand still are not part of "
        "this: "
        + ("those that stand in one another are named above." if summary["overlaps"] else "none stands in another."),
        "scan_words": f"The simulated scan has {summary['scan_points']:,} points in {summary['scan_profiles']:,} "
        "profiles.",
    }


def _millimetres(length_m: float, *, up: bool = True) -> str:
    """Return a length in mm with two digits behind the point; a proven least one is rounded down."""
    return f"{1e3 * length_m if up else np.floor(1e5 * length_m) / 100:.2f}"


def _tiles(summary: dict[str, Any]) -> list[dict[str, str]]:
    apart = summary["proven_distance_m"]
    return [
        {"value": f"{summary['coverage']:.2%}", "label": "of the surface measured"},
        {"value": f"{summary['coverage_of_coverable']:.2%}", "label": "of what any sweep can measure"},
        {"value": str(summary["executed_sweeps"]), "label": f"sweeps of {summary['candidates']:,} candidates"},
        {"value": f"{summary['duration_s']:.1f} s", "label": "cycle time"},
        {"value": f"{_micrometres(summary['uncertainty_median_m'])} µm", "label": "median uncertainty"},
        {
            "value": "–" if apart is None else f"{_millimetres(apart, up=False)} mm",
            "label": "proven least distance to anything",
        },
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
            "words": CAUSE_WORDS[cause] + (collided if cause is Cause.COLLISION else ""),
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


_SHOP_UNITS = {
    "m": ("mm", 1e3),
    "m/s": ("mm/s", 1e3),
    "m/s^2": ("m/s²", 1.0),
    "rad": ("°", 180.0 / np.pi),
    "rad/s": ("°/s", 180.0 / np.pi),
    "of the limit": ("%", 100.0),
}
"""Units as people on the shop floor use them, and the factor to them."""


def _check_rows(verification: Verification) -> list[dict[str, str]]:
    rows = []
    for check, found, permitted, unit, at_least in zip(
        verification.check,
        verification.found.tolist(),
        verification.permitted.tolist(),
        verification.unit,
        verification.at_least.tolist(),
    ):
        shown, factor = _SHOP_UNITS.get(unit, (unit, 1.0))
        unit_words = shown if shown in ("%", "°") else f" {shown}"
        rows.append(
            {
                "check": check
                + (" (below zero: room that is left)" if found < 0.0 else "")
                + (", of its limit" if shown == "%" else ""),
                "found": _plain(factor * found) + unit_words,
                "permitted": _bound(factor * permitted, at_least) + unit_words,
            }
        )
    return rows


def _bound(permitted: float, at_least: bool) -> str:
    if permitted == 0.0 and not at_least:
        return "0"
    return f"{'≥' if at_least else '≤'} {_plain(permitted)}".replace("≤ <", "<")


def _plain(value: float) -> str:
    """Return a number as people read it: no powers of ten, nothing beyond what matters."""
    if not np.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    if abs(value) < 1e-3:
        return "< 0.001" if value > 0.0 else "> -0.001"
    return f"{round(value, 3):.4g}" if abs(value) < 1e4 else f"{value:,.0f}"


def _mesh_facts(mesh: PartMesh) -> dict[str, Any]:
    return {
        "area": f"{1e4 * mesh.areas_m2.sum():,.1f}",
        "area_to_measure": f"{1e4 * mesh.areas_m2[mesh.to_measure].sum():,.1f}",
        "findings": list(mesh.finding),
    }


def _template() -> str:
    return resources.files("tasks").joinpath("templates/inspection_report.html.j2").read_text("utf-8")


def _plotly_js() -> str:
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _trusted(text: str) -> Any:
    """Mark our own script text as not to be escaped."""
    import markupsafe

    return markupsafe.Markup(text)  # plotly's own script, and JSON without "<"
