"""A still picture of a whole cell: robot at its start, scanner with its laser fan, part, standing bodies, world grid.

Three views are cast ray by ray (see `cellwright.figures.surface_view`): the whole cell from the side that hides least
of robot and part, from above, and the scanner close by. Bodies larger than robot and part together (floors, walls) set
no frame and are drawn as glass where they stand in front. Some half a second; equal cells give equal bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.cell.cell import Cell
from cellwright.cell.scanner import Scanner
from cellwright.cell.transforms import apply
from cellwright.figures.cell_layout import (
    COLOURS,
    PART_ROLE,
    ROBOT,
    SCANNER,
    STANDING,
    Layout,
    Solids,
    grid_box,
    grid_step,
    laid_out,
    laser_fan,
)
from cellwright.figures.coverage_map import plain_text, png_bytes, rgb
from cellwright.figures.surface_view import Camera, camera_on, cast_pictures

LASER = "#d1263f"
_AXES = ("#c0392b", "#2e8b57", "#2f5fc4")
_GRID = "#7d8792"
_GLASS = 0.25
"""Opacity of floors and walls in front of something."""
_OVERVIEW_DEG = [(azimuth, 24.0) for azimuth in (-60, -30, 30, 60, 120, 150, -150, -120)]
_SAMPLES = 2
"""Rays a pixel along each side."""
_SMALL = (400 * _SAMPLES, 306 * _SAMPLES)
_MOST_LABELS = 22


def cell_picture(cell: Cell, scanner: Scanner, robot_is: str = "at its start") -> bytes:
    """Draw a cell at its start configuration as PNG bytes.

    Args:
        cell: The cell, with the part as its last body if it is to be seen.
        scanner: Aperture and standoffs of the laser fan that is drawn.
        robot_is: Where the robot is, for the caption.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    layout = laid_out(cell)
    fan = apply(layout.T_world_scanner, laser_fan(scanner))
    figure = Figure(figsize=(12.0, 10.4), dpi=110)
    FigureCanvasAgg(figure)
    shown, _, _ = draw_overview(figure.add_axes((0.16, 0.435, 0.68, 0.555)), layout, fan, cell.robot.name)
    shown |= _from_above(figure.add_axes((0.06, 0.075, 0.41, 0.32)), layout, fan, shown)
    _close_up(figure.add_axes((0.54, 0.075, 0.41, 0.32)), layout, fan, scanner)
    _legend(figure, layout, shown, robot_is)
    return png_bytes(figure)


def _corners_of(box: FloatArray) -> FloatArray:
    grid = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1)
    return np.asarray(grid.reshape(-1, 3))


def _fitted(points: FloatArray, way: tuple[float, float], pixels: tuple[int, int]) -> tuple[Camera, FloatArray]:
    """Return the camera from a direction whose picture just holds some points, and the point that it looks at."""
    axes = Camera(*way, 1, 1, 1.0).axes()
    seen = points @ axes.T  # as the camera sees them: to the right, up, towards it
    camera = camera_on(np.stack([seen.min(axis=0), seen.max(axis=0)]) @ axes, way, pixels)
    return camera, np.asarray((seen.min(axis=0) + seen.max(axis=0)) / 2 @ axes)


def draw_overview(
    axes: Any, layout: Layout, fan: FloatArray | None, robot: str
) -> tuple[set[str], Callable[[FloatArray], FloatArray], FloatArray]:
    """Draw a whole cell from the side that hides least, with or without a laser fan (6, 3).

    Returns:
        The names of the bodies it shows, what maps points of the world (n, 3) in m into ``axes`` (n, 2), and the unit
        vector (3,) to the viewer.
    """
    near = layout.solids(large=False)
    middle = layout.frame.mean(axis=0)
    ways = [(math.radians(azimuth), math.radians(elevation)) for azimuth, elevation in _OVERVIEW_DEG]
    coarse = [camera_on(_corners_of(layout.frame), way, (160, 132)) for way in ways]
    wanted = np.array([role in (ROBOT, SCANNER, PART_ROLE) for role in layout.roles])
    hits = cast_pictures(near.vertices, near.faces, coarse, middle=middle)
    weight = np.where(np.array(layout.roles) == ROBOT, 1.0, 3.0) * wanted  # part and scanner matter most
    shown = [float((weight[near.body[each.face]] * each.hit).sum() * c.scale**2) for each, c in zip(hits, coarse)]
    way = ways[int(np.argmax(np.round(shown, 4)))]
    camera, middle = _fitted(layout.framed, way, (700 * _SAMPLES, 528 * _SAMPLES))
    seen = _draw(axes, layout, fan, camera, middle)
    _world_axes(axes, layout, camera, middle)
    _grid_labels(axes, layout, camera, middle)
    named = _labels(axes, layout, seen, camera, robot)
    return named, lambda points: _project(points, camera, middle), camera.axes()[2]


def _from_above(axes: Any, layout: Layout, fan: FloatArray, known: set[str]) -> set[str]:
    """Draw the view from above; return the names it shows of bodies that are not ``known`` yet."""
    camera, middle = _fitted(layout.framed, (-math.pi / 2, math.pi / 2), _SMALL)
    seen = _draw(axes, layout, fan, camera, middle)
    _world_axes(axes, layout, camera, middle)
    _grid_labels(axes, layout, camera, middle)
    axes.set_title("from above", fontsize=10, loc="left")
    wanted = [row for row, name in enumerate(layout.names) if layout.roles[row] != ROBOT and name not in known]
    found = [place for row in wanted[:_MOST_LABELS] if (place := _place(layout.names[row], seen == row, camera))]
    for name, x, y in found:
        axes.annotate(plain_text(_short(name)), (x, y), xytext=(6, 6), textcoords="offset points", fontsize=8.5,
                      color="#1d2731", annotation_clip=True)  # fmt: skip
    return {name for name, _, _ in found}


def _close_up(axes: Any, layout: Layout, fan: FloatArray, scanner: Scanner) -> None:
    shown = [role == SCANNER or (role == ROBOT and parent >= layout.n_joints - 1)
             for role, parent in zip(layout.roles, layout.parents)]  # fmt: skip
    tool = [points for role, points in zip(layout.roles, layout.corners) if role == SCANNER]
    last = [points for one, parent, points in zip(shown, layout.parents, layout.corners)
            if one and parent == layout.n_joints]  # fmt: skip
    # across the fan, a little turned, so that its width and the detector's side are seen; from above rather than below
    sides = layout.T_world_scanner[:3, :3] @ np.array([(x, y, 0.25) for x in (0.75, -0.75) for y in (0.5, -0.5)]).T
    across = sides[:, int(np.argmax(np.round(sides[2], 6)))]
    level = float(np.hypot(across[0], across[1]))
    azimuth = math.atan2(across[1], across[0]) if level > 1e-6 else -math.pi / 3
    way = (azimuth, max(math.atan2(across[2], level), math.radians(8.0)))
    camera, middle = _fitted(np.concatenate([fan, *tool, *last]), way, _SMALL)
    _draw(axes, layout, fan, camera, middle, only=np.array(shown))
    places = _project(fan[[0, 5]], camera, middle)
    left = 1 if places[1, 0] < places[0, 0] else 0
    for row, (place, word, mark) in enumerate(zip(places, ("emitter", "detector"), ("o", "s"))):
        axes.plot(*place, mark, color=LASER, markeredgecolor="white", markersize=6)
        axes.annotate(word, place, xytext=(-8, 6) if row == left else (8, 6), textcoords="offset points", fontsize=9,
                      ha="right" if row == left else "left", color="#5c0a18")  # fmt: skip
    ends = _project(fan[1:5], camera, middle)
    lines = np.where(ends[1::2, :1] > ends[::2, :1], ends[1::2], ends[::2])  # their ends on the right
    for place, length in zip(lines, (scanner.min_standoff, scanner.max_standoff)):
        axes.annotate(f"{1e3 * length:.0f} mm", place, xytext=(7, 3), textcoords="offset points", fontsize=9,
                      color="#5c0a18")  # fmt: skip
    axes.set_title("the scanner, its laser fan from smallest to largest standoff", fontsize=10, loc="left")


def _draw(
    axes: Any,
    layout: Layout,
    fan: FloatArray | None,
    camera: Camera,
    middle: FloatArray,
    only: BoolArray | None = None,
) -> IntArray:
    """Draw the bodies, the grid and the fan; return the body that each picture element shows, -1 for none."""
    solid, glass = layout.solids(large=False), layout.solids(large=True)
    if only is not None:
        kept = only[solid.body]
        solid = Solids(solid.vertices, solid.faces[kept], solid.body[kept])
    towards = camera.axes()[2]
    palette = np.array([rgb(COLOURS[role]) for role in layout.roles])
    [hits] = cast_pictures(solid.vertices, solid.faces, [camera], middle=middle)
    depth = np.where(hits.hit, (hits.point - middle) @ towards, -np.inf)
    body = np.where(hits.hit, solid.body[hits.face] if len(solid.body) else -1, -1)
    picture = np.where(hits.hit[..., None], palette[body] * hits.shade[..., None], 1.0)
    picture[_edges(body, depth, camera.scale)] *= 0.55
    if len(glass.faces) and only is None:
        [panes] = cast_pictures(glass.vertices, glass.faces, [camera], middle=middle)
        pane_depth = np.where(panes.hit, (panes.point - middle) @ towards, -np.inf)
        colour = 0.45 * np.array(rgb(COLOURS[STANDING])) + 0.55
        tint = colour * (0.6 + 0.4 * panes.shade[..., None])
        opacity = np.where(pane_depth > depth, np.where(hits.hit, _GLASS, 0.7), 0.0)[..., None]
        picture = picture * (1.0 - opacity) + tint * opacity
    if only is None:
        picture = _with_grid(picture, depth, layout.frame, camera, middle)
    if fan is not None:
        picture = _with_fan(picture, depth, fan, camera, middle)
    rows, columns = camera.height // _SAMPLES, camera.width // _SAMPLES
    small = picture[: rows * _SAMPLES, : columns * _SAMPLES].reshape(rows, _SAMPLES, columns, _SAMPLES, 3)
    half_width, half_height = camera.width * camera.scale / 2, camera.height * camera.scale / 2
    axes.imshow(
        small.mean(axis=(1, 3)), extent=(-half_width, half_width, -half_height, half_height), interpolation="none"
    )
    if fan is not None:
        axes.plot(*_project(fan[[0, 3, 4, 0]], camera, middle).T, color=LASER, linewidth=0.8)
    axes.set_xlim(-half_width, half_width)
    axes.set_ylim(-half_height, half_height)
    axes.set_axis_off()
    return np.asarray(body)


def _edges(body: IntArray, depth: FloatArray, scale: float) -> BoolArray:
    """Tell where another body begins, or the same one far behind: outlines tell shapes of one colour apart."""
    edge = np.zeros(body.shape, bool)
    finite = np.where(np.isfinite(depth), depth, -1e9)
    for axis in (0, 1):
        jump = (np.diff(body, axis=axis) != 0) | (np.abs(np.diff(finite, axis=axis)) > 25 * scale)
        first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        edge[first] |= jump
    return edge & (body >= 0)


def _with_grid(
    picture: FloatArray, depth: FloatArray, frame: FloatArray, camera: Camera, middle: FloatArray
) -> FloatArray:
    """Lay the grid of the plane z = 0 into a picture, behind what stands above it."""
    right, up, towards = camera.axes()
    if towards[2] < 0.05:
        return picture
    x = ((np.arange(camera.width) - (camera.width - 1) / 2) * camera.scale)[None, :]
    y = (((camera.height - 1) / 2 - np.arange(camera.height)) * camera.scale)[:, None]
    along = -(middle[2] + x * right[2] + y * up[2]) / towards[2]  # from the plane of the picture to z = 0
    step, (low, high) = grid_step(frame), grid_box(frame)
    wide = 0.7 * camera.scale * _SAMPLES / max(abs(float(towards[2])), 0.3)
    line, inside = np.zeros(along.shape), np.ones(along.shape, bool)
    for axis in (0, 1):
        place = middle[axis] + x * right[axis] + y * up[axis] + along * towards[axis]
        offset = np.abs(place - step * np.round(place / step))
        line = np.maximum(line, np.clip(1.1 - offset / wide, 0.0, 1.0))
        inside &= (place >= low[axis] - wide) & (place <= high[axis] + wide)
    opacity = (0.55 * line * (inside & (along >= depth - 1e-4)))[..., None]
    return np.asarray(picture * (1.0 - opacity) + np.array(rgb(_GRID)) * opacity)


def _with_fan(
    picture: FloatArray, depth: FloatArray, fan: FloatArray, camera: Camera, middle: FloatArray
) -> FloatArray:
    """Lay the laser's plane into a picture: pale from the emitter, full from the smallest standoff on."""
    right, up, towards = camera.axes()
    across, along = fan[4] - fan[3], (fan[3] + fan[4]) / 2 - fan[0]
    normal = np.cross(across, along)
    facing = float(normal @ towards)
    if abs(facing) < 1e-3 * float(np.linalg.norm(normal)):
        return picture  # seen from its edge
    box = _project(fan[:5], camera, middle) / camera.scale
    columns = np.clip(np.array([box[:, 0].min(), box[:, 0].max() + 2]) + camera.width / 2, 0, camera.width).astype(int)
    rows = np.clip(camera.height / 2 - np.array([box[:, 1].max() + 1, box[:, 1].min() - 1]), 0, camera.height)
    part = (slice(int(rows[0]), int(rows[1]) + 1), slice(columns[0], columns[1]))
    x = (np.arange(camera.width)[part[1]] - (camera.width - 1) / 2) * camera.scale
    y = ((camera.height - 1) / 2 - np.arange(camera.height)[part[0]]) * camera.scale
    origin = middle + x[None, :, None] * right + y[:, None, None] * up
    reach = ((fan[0] - origin) @ normal) / facing
    away = origin + reach[..., None] * towards - fan[0]
    share = (away @ along) / float(along @ along)  # 0 at the emitter, 1 at the largest standoff
    side = np.abs(away @ across) / float(across @ across)
    nearest = float(((fan[1] + fan[2]) / 2 - fan[0]) @ along) / float(along @ along)
    lit = (share >= 0.0) & (share <= 1.0) & (side <= share / 2) & (reach > depth[part])
    opacity = np.where(lit, np.where(share < nearest, 0.15, 0.5), 0.0)[..., None]
    picture = picture.copy()
    picture[part] = picture[part] * (1.0 - opacity) + np.array(rgb(LASER)) * opacity
    return picture


def _project(points: FloatArray, camera: Camera, middle: FloatArray) -> FloatArray:
    return np.asarray((points - middle) @ camera.axes()[:2].T)


def _world_axes(axes: Any, layout: Layout, camera: Camera, middle: FloatArray) -> None:
    length = 0.15 * float((layout.frame[1] - layout.frame[0]).max())
    ends = _project(np.vstack([np.zeros(3), length * np.eye(3), 1.18 * length * np.eye(3)]), camera, middle)
    for axis, (name, colour) in enumerate(zip("xyz", _AXES)):
        if np.linalg.norm(ends[1 + axis] - ends[0]) < 0.05 * length:
            continue
        axes.annotate("", ends[1 + axis], ends[0], arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.8,
                      "shrinkA": 0, "shrinkB": 0}, annotation_clip=True)  # fmt: skip
        axes.text(
            *ends[4 + axis], name, color=colour, fontsize=10, ha="center", va="center", clip_on=True, weight="bold"
        )


def _grid_labels(axes: Any, layout: Layout, camera: Camera, middle: FloatArray) -> None:
    """Write metres along the two edges of the grid that are nearest to the camera."""
    step, (low, high) = grid_step(layout.frame), grid_box(layout.frame)
    towards = camera.axes()[2][:2]
    if np.linalg.norm(towards) < 1e-6:
        towards = np.array([-1.0, -1.0])
    near_y = high[1] if towards[1] > 0 else low[1]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    for axis, name in enumerate("xy"):
        other = 1 - axis
        edge = high[other] if towards[other] > 0 else low[other]
        for value in np.arange(low[axis], high[axis] + step / 2, step):
            if axis == 1 and abs(value - near_y) < step / 2:
                continue  # the corner has its label along x
            place = np.zeros(3)
            place[axis], place[other] = value, edge
            at = _project(place[None], camera, middle)[0]
            outward = _project(
                (place + np.eye(3)[other] * (step if edge == high[other] else -step))[None], camera, middle
            )
            shift = outward[0] - at
            shift = 9 * shift / max(float(np.linalg.norm(shift)), 1e-12)
            axes.annotate(f"{name} {value + 0.0:.{decimals}f}", at, xytext=tuple(shift), textcoords="offset points",
                          ha="center", va="center", fontsize=7.5, color="#5b6874", annotation_clip=True)  # fmt: skip


def _labels(axes: Any, layout: Layout, seen: IntArray, camera: Camera, robot: str) -> set[str]:
    """Write the bodies' names in columns beside the picture, with lines to where they are seen; return them."""
    wanted: list[tuple[str, BoolArray]] = [(f"robot {robot}", np.array([role == ROBOT for role in layout.roles]))]
    wanted += [
        (name, np.arange(len(layout.names)) == row)
        for row, (name, role) in enumerate(zip(layout.names, layout.roles))
        if role != ROBOT and not layout.large[row]
    ][:_MOST_LABELS]
    found = [place for name, rows in wanted if (place := _place(name, np.append(rows, False)[seen], camera))]
    half_width, half_height = camera.width * camera.scale / 2, camera.height * camera.scale / 2
    for side in (-1, 1):
        column = [item for item in found if (item[1] > 0) == (side > 0)]
        heights = _spread([y for _, _, y in sorted(column, key=lambda item: -item[2])], half_height)
        for (name, x, y), at in zip(sorted(column, key=lambda item: -item[2]), heights):
            axes.annotate(
                plain_text(_short(name)), (x, y), xytext=(side * 1.02 * half_width, at),
                ha="left" if side > 0 else "right", va="center", fontsize=9.5, color="#1d2731", annotation_clip=False,
                arrowprops={"arrowstyle": "-", "color": "#1d2731", "linewidth": 0.6, "shrinkA": 2, "shrinkB": 0},
            )  # fmt: skip
            axes.plot(x, y, "o", color="#1d2731", markersize=2.5)

    return {name for name, _, _ in found}


def _place(name: str, shown: BoolArray, camera: Camera) -> tuple[str, float, float] | None:
    """Return where to point at a body in the plane of the picture, in m; none where it is not seen."""
    height, width = np.nonzero(shown)
    if len(height) < 12:
        return None
    # the element nearest to the middle: the middle itself may lie in a hole or behind another body
    nearest = int(np.argmin((height - height.mean()) ** 2 + (width - width.mean()) ** 2))
    x = (width[nearest] + 0.5 - camera.width / 2) * camera.scale
    y = (camera.height / 2 - height[nearest] - 0.5) * camera.scale
    return name, float(x), float(y)


def _short(name: str) -> str:
    return name if len(name) <= 24 else f"{name[:23]}…"


def _spread(heights: Sequence[float], half_height: float) -> list[float]:
    """Move falling heights apart so that lines of text do not meet, and keep them beside the picture."""
    gap = 2 * half_height / 24
    placed: list[float] = []
    for wanted in heights:
        placed.append(min(wanted, placed[-1] - gap) if placed else min(wanted, half_height))
    for row in reversed(range(len(placed))):
        lowest = -half_height if row == len(placed) - 1 else placed[row + 1] + gap
        placed[row] = max(placed[row], lowest)
    return placed


def _legend(figure: Any, layout: Layout, shown: set[str], robot_is: str) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=colour, label=role) for role, colour in COLOURS.items() if role in layout.roles]
    handles.append(Patch(color=LASER, alpha=0.5, label="laser fan"))
    large = [name for name, is_large in zip(layout.names, layout.large) if is_large]
    if large:
        pale = tuple((0.45 * np.array(rgb(COLOURS[STANDING])) + 0.55).tolist())
        handles.append(Patch(color=pale, label=plain_text(f"larger than the picture: {_listed(large)}")))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=10)
    hidden = [
        name
        for name, role, is_large in zip(layout.names, layout.roles, layout.large)
        if role != ROBOT and not is_large and name not in shown
    ]
    words = f"Grid on z = 0 of the world, every {1e3 * grid_step(layout.frame):.0f} mm, in m; robot {robot_is}."
    if hidden:
        words += f" Hidden, or too far away to be shown: {_listed(hidden)}."
    figure.text(0.5, 0.042, plain_text(words), ha="center", fontsize=9, color="#5b6874")


def _listed(names: Sequence[str]) -> str:
    few = ", ".join(map(_short, names[:4]))
    return few + (f" and {len(names) - 4} more" if len(names) > 4 else "")
