"""The picture of a cell shows every body where it stands, in the colour of its role, and where the laser points."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from PIL import Image

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import WORLD, Body, Box, Mesh, Sphere
from cellwright.cell.cell import Cell
from cellwright.cell.scanner import Scanner
from cellwright.cell.tessellation import triangles_of
from cellwright.cell.transforms import pose
from cellwright.figures.cell_layout import COLOURS, PART_ROLE, ROBOT, SCANNER, STANDING, laid_out, laser_fan
from cellwright.figures.cell_view import cell_picture
from cellwright.figures.coverage_map import rgb
from schemas.cell_objects import build_cell
from tests.tasks import plan_artefacts as plan

LASER = Scanner(math.radians(30), 0.1, 0.15, 0.2, 0.05, 0.0, 1e-3, 1.2, 100.0, 100)


def at(x: float, y: float, z: float) -> FloatArray:
    return pose(np.array([x, y, z]), np.eye(3))


@cache
def cell() -> Cell:
    vertices, faces = triangles_of(Box((0.1, 0.1, 0.1)))
    return build_cell(plan.cell()).with_part(Mesh(vertices, faces.astype(np.int32)), at(0.3, 0.3, 0.05))


def with_bodies(*bodies: Body) -> Cell:
    return replace(cell(), bodies=(*bodies, *cell().bodies))


def shares(png: bytes) -> dict[str, float]:
    """Return the share of coloured pixels that each role's colour has; shading keeps the ratio of the channels."""
    with Image.open(io.BytesIO(png)) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3) / 255.0
    pixels = pixels[(pixels.min(axis=1) < 0.9) & (pixels.max(axis=1) > 0.15)]
    palette = np.array([rgb(colour) for colour in COLOURS.values()])
    palette /= np.linalg.norm(palette, axis=1, keepdims=True)
    near = (pixels / np.linalg.norm(pixels, axis=1, keepdims=True)) @ palette.T
    found, sure = np.argmax(near, axis=1), near.max(axis=1) > 0.9995
    return {role: float(((found == row) & sure).sum()) / len(pixels) for row, role in enumerate(COLOURS)}


def test_every_role_is_seen_in_its_colour() -> None:
    found = shares(cell_picture(cell(), LASER))
    assert set(found) == {ROBOT, SCANNER, PART_ROLE, STANDING}
    assert all(share > 0.001 for share in found.values()), found


def test_equal_cells_give_equal_bytes_and_a_moved_body_others() -> None:
    first = cell_picture(cell(), LASER)
    assert cell_picture(cell(), LASER) == first
    assert cell_picture(with_bodies(Body("post", Sphere(0.1), WORLD, at(0.2, -0.3, 0.1))), LASER) != first


def test_bodies_stand_where_the_cell_says_at_the_start() -> None:
    layout = laid_out(cell())
    own = dict(zip(layout.names, layout.corners))
    np.testing.assert_allclose((own["part"].min(axis=0) + own["part"].max(axis=0)) / 2, [0.3, 0.3, 0.05], atol=1e-12)
    roles = dict(zip(layout.names, layout.roles))
    assert (roles["part"], roles["table"], roles["base_link"]) == (PART_ROLE, STANDING, ROBOT)
    assert roles["camera"] == SCANNER
    T_base_link = cell().robot.link_poses(cell().start)
    T = cell().T_world_base @ T_base_link[2] @ next(b.T_parent_body for b in cell().bodies if b.name == "camera")
    np.testing.assert_allclose((own["camera"].min(axis=0) + own["camera"].max(axis=0)) / 2, T[:3, 3], atol=1e-12)


def test_the_fan_is_as_wide_and_as_far_as_the_scanner_sees() -> None:
    emitter, near_left, near_right, far_left, far_right, detector = laser_fan(LASER)
    np.testing.assert_allclose(emitter, 0.0)
    assert (near_left[2], far_left[2]) == (0.1, 0.2)
    for left, right in ((near_left, near_right), (far_left, far_right)):
        cosine = left @ right / np.linalg.norm(left) / np.linalg.norm(right)
        assert math.acos(cosine) == pytest.approx(LASER.aperture)
        assert left[0] == right[0] == 0.0
    np.testing.assert_allclose(detector, [-0.05, 0.0, 0.0])


def test_floors_walls_and_far_bodies_do_not_set_the_frame() -> None:
    alone = laid_out(cell()).frame
    floor = Body("floor", Box((30.0, 30.0, 0.1)), WORLD, at(0, 0, -0.3))
    far = Body("far", Box((0.2, 0.2, 0.2)), WORLD, at(50.0, 0, 0))
    found = laid_out(with_bodies(floor, far))
    np.testing.assert_allclose(found.frame, alone)
    assert dict(zip(found.names, found.large))["floor"]
    assert not dict(zip(found.names, found.large))["far"]
    near = Body("near", Box((0.1, 0.1, 0.1)), WORLD, at(0.0, -0.9, 0.0))
    assert laid_out(with_bodies(near)).frame[0, 1] == pytest.approx(min(-0.95, alone[0, 1]))


def test_a_wall_in_front_is_glass() -> None:
    walls = [
        Body(f"wall {number}", Box(size), WORLD, at(x, y, 0.0))
        for number, (size, x, y) in enumerate(
            (((0.05, 9.0, 9.0), 3.0, 0.0), ((0.05, 9.0, 9.0), -3.0, 0.0), ((9.0, 0.05, 9.0), 0.0, 3.0),
             ((9.0, 0.05, 9.0), 0.0, -3.0))
        )
    ]  # fmt: skip
    with Image.open(io.BytesIO(cell_picture(with_bodies(*walls), LASER))) as image:
        pixels = np.asarray(image.convert("RGB")).astype(float)[:600]
    # the part behind glass is still green
    assert ((pixels[..., 1] > pixels[..., 0] + 15) & (pixels[..., 1] > pixels[..., 2] + 5)).sum() > 100


def test_names_are_shown_as_they_are_written() -> None:
    odd = Body("clamp $1_{x}$ 夹 with a name that is much too long", Box((0.1, 0.1, 0.1)), WORLD, at(0.4, -0.2, 0.05))
    plain = replace(odd, name="clamp")
    with pytest.warns(UserWarning, match="Glyph"):
        assert cell_picture(with_bodies(odd), LASER) != cell_picture(with_bodies(plain), LASER)
