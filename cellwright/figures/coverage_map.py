"""The coverage of a part as a picture and as an interactive 3D view: what was measured, what was missed and why."""

from __future__ import annotations

import io
import math

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array
from cellwright.causes import Cause
from cellwright.figures.surface_view import cameras_around, cast_pictures, paint

CAUSE_COLOURS: dict[Cause, str] = {
    Cause.NONE: "#2a9d5c",
    Cause.FIELD_OF_VIEW: "#7b5ea7",
    Cause.INCIDENCE: "#5468c4",
    Cause.UNCERTAINTY: "#3fa7d6",
    Cause.EMITTER_OCCLUDED: "#a63d2f",
    Cause.DETECTOR_OCCLUDED: "#d1495b",
    Cause.OUT_OF_REACH: "#8d6a3f",
    Cause.JOINT_LIMIT: "#b58b4c",
    Cause.COLLISION: "#e07a1f",
    Cause.JOINT_SPEED: "#c9a227",
    Cause.TOO_SHORT: "#6c757d",
    Cause.NOT_SELECTED: "#f4d35e",
    Cause.NOT_SCANNED: "#22304f",
    Cause.NOT_CONNECTED: "#b8418f",
}
"""One colour a cause, the same in every picture."""

NOT_TO_MEASURE = "#c9ccd1"
"""Colour of faces that need not be measured."""


def rgb(colour: str) -> tuple[float, float, float]:
    """Turn ``#rrggbb`` into three numbers from 0 to 1."""
    return int(colour[1:3], 16) / 255, int(colour[3:5], 16) / 255, int(colour[5:7], 16) / 255


_DIRECTIONS_DEG = [(-60, 28), (30, 28), (120, 28), (-150, -28)]
"""Azimuth and elevation of the views: all sides from above, and one from below."""

_TALL = 0.8
"""Pictures whose width is a smaller share of their height than this stand in one row."""

_FLAT = 0.8
"""Share of the brightness of faces not to be measured that does not depend on the light."""

_TURN = 2.1
"""Spacings that unit normals are stretched to."""


def coverage_picture(
    vertices: FloatArray,
    faces: Int32Array,
    to_measure: BoolArray,
    points: FloatArray,
    normals: FloatArray,
    cause: Int8Array,
    *,
    spacing: float,
    two_sided: bool = False,
) -> bytes:
    """Render the part from four sides, coloured by the cause of the nearest cloud point on the same side, as PNG bytes.

    Args:
        vertices: Part vertices in m, (n, 3).
        faces: Its triangles, (m, 3).
        to_measure: Whether a face is to be measured, (m,).
        points: Cloud points in m, (k, 3).
        normals: Their unit normals, (k, 3).
        cause: Their causes, (k,).
        spacing: Typical distance between cloud points in m; pixels further than four of it from any stay grey.
        two_sided: Whether both sides of a face have cloud points: then the one that faces the camera is shown.
    """
    from scipy.spatial import cKDTree

    # a normal turned by a right angle counts as far as three spacings: the two sides of thin walls keep apart
    tree = cKDTree(np.hstack([points, _TURN * spacing * normals]))
    corners = vertices[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face_normals = crosses / np.maximum(np.linalg.norm(crosses, axis=1, keepdims=True), 1e-300)
    palette = np.array([rgb(CAUSE_COLOURS[cause]) for cause in Cause])
    views = []
    ways = [(math.radians(azimuth), math.radians(elevation)) for azimuth, elevation in _DIRECTIONS_DEG]
    cameras = cameras_around(vertices, ways)
    for camera, hits in zip(cameras, cast_pictures(vertices, faces, cameras), strict=True):
        colours = np.tile(np.array(rgb(NOT_TO_MEASURE)), (*hits.hit.shape, 1))
        wanted = hits.hit & to_measure[hits.face]
        seen = face_normals[hits.face[wanted]]
        if two_sided:
            seen = np.where((seen @ camera.axes()[2] < 0)[:, None], -seen, seen)
        place = np.hstack([hits.point[wanted], _TURN * spacing * seen])
        distance, nearest = tree.query(place, distance_upper_bound=4 * spacing)
        near = np.isfinite(distance)
        found = colours[wanted]
        found[near] = palette[cause[nearest[near]]]
        colours[wanted] = found
        plain = hits.hit.copy()
        plain[wanted] = ~near
        # hardly shaded, so that it looks like its colour in the legend
        colours[plain] *= (_FLAT / hits.shade[plain] + 1 - _FLAT)[:, None]
        views.append(paint(hits, colours))
    return _sheet(views, cause)


def _sheet(views: list[FloatArray], cause: Int8Array) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    height, width = views[0].shape[:2]
    n_columns = len(views) if width < _TALL * height else 2
    n_rows = -(-len(views) // n_columns)
    figure_width = 12.0
    picture_height = n_rows * figure_width / n_columns * height / width
    figure = Figure(figsize=(figure_width, picture_height + 0.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for place, view in enumerate(views):
        axes = figure.add_subplot(n_rows, n_columns, place + 1)
        axes.imshow(view)
        axes.set_axis_off()
    counts = np.bincount(cause, minlength=len(Cause))
    handles = [
        Patch(color=CAUSE_COLOURS[which], label=f"{_label(which)}: {counts[which] / len(cause):.2%}")
        for which in Cause
        if counts[which]
    ]
    handles.append(Patch(color=NOT_TO_MEASURE, label="not to be measured"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=11)
    return png_bytes(figure)


def _label(cause: Cause) -> str:
    return "measured" if cause is Cause.NONE else cause.label


def png_bytes(figure: object) -> bytes:
    """Return a matplotlib figure as PNG bytes without date or version, so that equal figures are equal bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})  # type: ignore[attr-defined]  # Figure, lazily
    return stream.getvalue()


def plain_text(text: str) -> str:
    """Return a text so that matplotlib shows it as it is: a dollar sign begins no formula."""
    return text.replace("$", r"\$")
