"""Sphere hulls as pictures: the body inside its spheres for several numbers of them, and how the fit improves.

The first is Baumgaertner 2025, figure 3: a body under its hull. The body shows through the spheres where it is near to
their skin, as through milk glass, so that one sees how much the hull adds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray
from cellwright.figures.coverage_map import plain_text, png_bytes, rgb
from cellwright.figures.surface_view import Camera, cameras_around, cast_pictures, paint

_BODY, _MISSED = "#5b6b7b", "#d1495b"
_HULL = ("#3fa7d6", "#2a9d5c", "#e07a1f", "#7b5ea7", "#c9a227", "#3f6fd6")
"""Colours of the spheres, in turn, so that neighbours can be told apart."""
_DIRECTION_DEG = (-55.0, 24.0)
_OPACITY = 0.62
_PANEL_PIXELS = 520
_RINGS = 24

_PANEL, _TITLE = 3.4, 0.45
"""Width of a panel and height of its title, in inches."""

Spheres = tuple[FloatArray, FloatArray]
"""Centres (k, 3) and radii (k,) in m."""

Hull = tuple[str, FloatArray, FloatArray]
"""Title, centres (k, 3) and radii (k,) in m."""

HullRow = tuple[str, FloatArray, Int32Array, Sequence[Hull]]
"""Name, vertices (n, 3) in m and faces (m, 3) of a body, and its hulls."""

Views = list[tuple[str, FloatArray]]
"""Titles and pictures (height, width, 3)."""


def hull_picture(
    vertices: FloatArray,
    faces: Int32Array,
    hulls: Sequence[tuple[str, FloatArray, FloatArray]],
    *,
    direction_deg: tuple[float, float] = _DIRECTION_DEG,
) -> bytes:
    """Render a body, then the body under each hull, side by side, as PNG bytes.

    Parts of the body that no sphere holds are red: they show through the hull without any milk.

    Args:
        vertices: Of the body in m, (n, 3).
        faces: Its triangles, (m, 3).
        hulls: Title, centres (k, 3) and radii (k,) in m of each hull.
        direction_deg: Azimuth and elevation of the view.
    """
    views = _views(vertices, faces, hulls, direction_deg)
    height, width = views[0][1].shape[:2]
    n_columns = min(len(views), 4 if width < 1.3 * height else 3)
    rows = [views[first : first + n_columns] for first in range(0, len(views), n_columns)]
    return _sheet([("", row) for row in rows], "")


def hull_rows_picture(
    rows: Sequence[HullRow], *, title: str = "", direction_deg: tuple[float, float] = _DIRECTION_DEG
) -> bytes:
    """Render several bodies, each in a row under its hulls, as PNG bytes; else as `hull_picture`."""
    views = [(name, _views(vertices, faces, hulls, direction_deg)) for name, vertices, faces, hulls in rows]
    return _sheet(views, title)


def _views(vertices: FloatArray, faces: Int32Array, hulls: Sequence[Hull], direction_deg: tuple[float, float]) -> Views:
    """Return titles and colours (height, width, 3) of a body and of the body under each hull."""
    balls = [_triangles(centres, radii) for _, centres, radii in hulls]
    everything = np.concatenate([vertices, *(points for points, _, _ in balls)])
    way = (math.radians(direction_deg[0]), math.radians(direction_deg[1]))
    [camera] = cameras_around(everything, [way], _PANEL_PIXELS)
    views = [("body", _body_view(camera, everything, vertices, faces, None))]
    for (title, centres, radii), ball in zip(hulls, balls):
        views.append((title, _hull_view(camera, everything, vertices, faces, (centres, radii), ball)))
    return views


def _sheet(rows: Sequence[tuple[str, Views]], title: str) -> bytes:
    """Draw rows of views, each with its name on the left, as PNG bytes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n_columns = max(len(views) for _, views in rows)
    heights = [_PANEL * max(view.shape[0] / view.shape[1] for _, view in views) + _TITLE for _, views in rows]
    size = (_PANEL * n_columns, sum(heights) + (_TITLE if title else 0.0))
    figure = Figure(figsize=size, dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    places = figure.add_gridspec(len(rows), n_columns, height_ratios=heights)
    for row, (name, views) in enumerate(rows):
        for column, (label, view) in enumerate(views):
            axes = figure.add_subplot(places[row, column])
            axes.imshow(view)
            axes.set_title(plain_text(f"{name}\n{label}" if name and column == 0 else label), fontsize=11)
            axes.set_axis_off()
    if title:
        figure.suptitle(plain_text(title))
    return png_bytes(figure)


def metrics_chart(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Draw volume ratio, protrusion, gap and coverage over the number of spheres, a line a method, as PNG bytes.

    Args:
        rows: ``line`` (a name), ``n_spheres``, ``volume_ratio``, ``coverage``, ``protrusion_mean``, ``protrusion_p95``,
            ``protrusion_max``, ``gap_mean``, ``gap_max`` (lengths in m).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = (
        ("hull's volume, of the body's", ("volume_ratio",), 1.0),
        ("protrusion, mm (mean, 95 %, largest)", ("protrusion_mean", "protrusion_p95", "protrusion_max"), 1e3),
        ("largest gap, mm", ("gap_max",), 1e3),
        ("surface in a sphere, %", ("coverage",), 100.0),
    )
    figure = Figure(figsize=(11, 6.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    lines = list(dict.fromkeys(str(row["line"]) for row in rows))
    handles: list[Any] = []
    for place, (label, columns, factor) in enumerate(panels):
        axes = figure.add_subplot(2, 2, place + 1)
        for number, line in enumerate(lines):
            chosen = sorted((row for row in rows if row["line"] == line), key=lambda row: int(row["n_spheres"]))
            for column, style in zip(columns, ("-", "--", ":")):
                drawn = axes.plot(
                    [row["n_spheres"] for row in chosen],
                    [factor * row[column] for row in chosen],
                    style,
                    marker="o" if style == "-" else None,
                    markersize=4,
                    color=_HULL[number % len(_HULL)],
                    label=plain_text(line),
                )
                if place == 0:
                    handles += drawn
        axes.set_xscale("log")
        ticks = sorted({int(row["n_spheres"]) for row in rows})
        axes.set_xticks(ticks, [str(tick) for tick in ticks])
        axes.minorticks_off()
        axes.set_xlabel("spheres")
        axes.set_ylabel(label)
        axes.grid(color="#e3e7eb", linewidth=0.8)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(handles=handles, loc="outside upper center", ncols=len(lines), frameon=False)
    return png_bytes(figure)


def _triangles(centres: FloatArray, radii: FloatArray) -> tuple[FloatArray, Int32Array, IntArray]:
    """Return vertices, faces and each face's sphere of balls as polyhedra."""
    theta = math.pi * np.arange(_RINGS + 1) / _RINGS
    phi = math.pi * np.arange(2 * _RINGS) / _RINGS
    x = np.outer(np.sin(theta), np.cos(phi))
    y = np.outer(np.sin(theta), np.sin(phi))
    z = np.broadcast_to(np.cos(theta)[:, None], x.shape)
    unit = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    n = 2 * _RINGS
    here, beside = np.arange(n), (np.arange(n) + 1) % n
    quads = [
        np.concatenate(
            [
                np.stack([n * ring + here, n * (ring + 1) + here, n * (ring + 1) + beside], axis=1),
                np.stack([n * ring + here, n * (ring + 1) + beside, n * ring + beside], axis=1),
            ]
        )
        for ring in range(_RINGS)
    ]
    one = np.concatenate(quads)
    vertices = (centres[:, None] + radii[:, None, None] * unit).reshape(-1, 3)
    faces = (one[None] + len(unit) * np.arange(len(radii))[:, None, None]).reshape(-1, 3)
    return vertices, faces.astype(np.int32), np.repeat(np.arange(len(radii)), len(one))


def _framed(vertices: FloatArray, faces: Int32Array, everything: FloatArray) -> tuple[FloatArray, Int32Array]:
    """Return the mesh with two corners more, of no face, so that cameras look at the middle of everything."""
    corners = np.stack([everything.min(axis=0), everything.max(axis=0)])
    return np.concatenate([vertices, corners]), faces


def _body_view(
    camera: Camera, everything: FloatArray, vertices: FloatArray, faces: Int32Array, spheres: Spheres | None
) -> FloatArray:
    [hits] = cast_pictures(*_framed(vertices, faces, everything), [camera])
    colours = np.tile(np.array(rgb(_BODY)), (*hits.hit.shape, 1))
    if spheres is not None:
        colours[_missed(hits.point, *spheres) & hits.hit] = rgb(_MISSED)
    return paint(hits, colours)


def _missed(points: FloatArray, centres: FloatArray, radii: FloatArray) -> Any:
    """Tell which points (height, width, 3) no ball holds; single-precision rays may be off by a millionth."""
    slack = 1e-5 * float(radii.max())
    missed = np.ones(points.shape[:2], bool)
    for centre, radius in zip(centres, radii):
        missed &= np.linalg.norm(points - centre, axis=-1) > radius + slack
    return missed


def _hull_view(
    camera: Camera,
    everything: FloatArray,
    vertices: FloatArray,
    faces: Int32Array,
    spheres: Spheres,
    ball: tuple[FloatArray, Int32Array, IntArray],
) -> FloatArray:
    body = _body_view(camera, everything, vertices, faces, spheres)
    [hits] = cast_pictures(*_framed(ball[0], ball[1], everything), [camera])
    [behind] = cast_pictures(*_framed(vertices, faces, everything), [camera])
    palette = np.array([rgb(colour) for colour in _HULL])
    skin = paint(hits, palette[ball[2][hits.face] % len(palette)])
    towards = camera.axes()[2]
    # how deep the body lies under the skin along the ray; what sticks out is not covered by milk
    depth = ((hits.point - behind.point) @ towards) / (0.35 * float(spheres[1].max()))
    milk = np.where(behind.hit, _OPACITY * np.clip(0.45 + depth, 0.0, 1.0), _OPACITY)
    milk = np.where(hits.hit & ~(behind.hit & (depth < 0.0)), milk, 0.0)[..., None]
    return np.asarray(body * (1.0 - milk) + skin * milk)
