"""The 3D view of the report as JSON: part, points of the verification cloud by cause, sweeps; in mm, frame `part`."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from cellwright.arrays import AnyArray, BoolArray, FloatArray
from cellwright.causes import Cause
from cellwright.cell.transforms import rotation_from_quaternion
from schemas.motion import Trajectory
from schemas.part import PartMesh, SurfaceSamples
from schemas.views import Coverage, Viewpoints

_OFF_SURFACE = 0.002
"""How far the points of the 3D view stand off the surface, as a share of the part's diagonal."""

_LIGHT = np.array([0.55, 0.35, 0.76])
"""Where the light of the 3D view comes from: a unit vector in the frame of the part."""

_SHADES = 9
"""The brightest shade of a point; the darkest is 0."""


def scene_json(
    mesh: PartMesh,
    cloud: SurfaceSamples,
    coverage: Coverage,
    viewpoints: Viewpoints,
    trajectory: Trajectory,
    max_points: int,
) -> str:
    """Return the view as JSON that can stand in a script, with at most ``max_points`` points of the cloud."""
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
        rows = np.flatnonzero(of_cause)[:: stride_missed if cause else stride]
        clouds.append(
            {
                "name": "measured" if cause is Cause.NONE else cause.label,
                "colour": CAUSE_COLOURS[cause],
                "missed": bool(cause),
                "shade": np.rint(_SHADES * (0.5 + 0.5 * cloud.normals[rows] @ _LIGHT)).astype(int).tolist(),
                "uncertainty": [] if cause else _micrometres(coverage.uncertainty_m[rows]),
                **_xyz(shown[rows]),
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
    lines: dict[str, list[Any]] = {"x": [], "y": [], "z": [], "text": [], "hover": []}
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
        lasted = trajectory.end_s[segment] - trajectory.start_s[segment]
        length = 1e3 * abs(travel[1] - travel[0])
        lines["hover"] += [f"sweep {number}: {length:.0f} mm in {lasted:.2f} s"] * 3
    return lines


def _micrometres(lengths: AnyArray) -> list[float | None]:
    return [round(1e6 * length, 1) if np.isfinite(length) else None for length in lengths.tolist()]


def _xyz(points: FloatArray) -> dict[str, list[float]]:
    x, y, z = np.round(1e3 * points, 2).T.tolist()
    return {"x": x, "y": y, "z": z}
