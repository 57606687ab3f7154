"""The coverage picture: the right colours at the right places, whatever the part's shape."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
import trimesh
from PIL import Image

from cellwright.arrays import AnyArray, BoolArray, FloatArray, Int32Array
from cellwright.causes import Cause
from cellwright.figures.coverage_map import CAUSE_COLOURS, NOT_TO_MEASURE, coverage_picture, rgb
from cellwright.figures.surface_view import cameras_around, cast_pictures, paint

WAYS = [(math.radians(-60), math.radians(28)), (math.radians(30), math.radians(28)), (0.0, math.radians(-80))]


def box(*size: float, at: tuple[float, float, float] = (0, 0, 0)) -> tuple[FloatArray, Int32Array]:
    solid = trimesh.creation.box(extents=size)
    return np.asarray(solid.vertices) + at, np.asarray(solid.faces, np.int32)


def hues(png: bytes) -> dict[str, float]:
    """Return the share of the part's pixels that each cause's colour has; shading keeps the ratio of the channels."""
    with Image.open(io.BytesIO(png)) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3) / 255.0
    pixels = pixels[(pixels.min(axis=1) < 0.93) & (pixels.max(axis=1) > 0.08)]  # neither ground nor text
    direction = pixels / np.linalg.norm(pixels, axis=1, keepdims=True)
    names = {cause.label: CAUSE_COLOURS[cause] for cause in Cause} | {"grey": NOT_TO_MEASURE}
    palette = np.array([rgb(colour) for colour in names.values()])
    palette /= np.linalg.norm(palette, axis=1, keepdims=True)
    nearest = np.argmax(direction @ palette.T, axis=1)
    return {name: float((nearest == row).mean()) for row, name in enumerate(names)}


def picture(cause_of_low: Cause, measure_low: bool = True) -> bytes:
    """A box of 0.1 x 0.1 x 0.2 m; its lower half is missed."""
    vertices, faces = box(0.1, 0.1, 0.2)
    solid = trimesh.Trimesh(vertices, faces).subdivide_to_size(0.02)
    points, face = trimesh.sample.sample_surface(solid, 4000, seed=1)
    normals = np.asarray(solid.face_normals)[face]
    faces = np.asarray(solid.faces, np.int32)
    low_faces: BoolArray = solid.triangles_center[:, 2] < 0
    cause = np.where(points[:, 2] < 0, cause_of_low, Cause.NONE).astype(np.int8)
    return coverage_picture(
        np.asarray(solid.vertices), faces, measure_low | ~low_faces, np.asarray(points), normals, cause, spacing=0.005
    )


@pytest.mark.parametrize("cause", [Cause.COLLISION, Cause.NOT_SELECTED, Cause.NOT_SCANNED, Cause.FIELD_OF_VIEW])
def test_each_half_has_the_colour_of_its_cause(cause: Cause) -> None:
    found = hues(picture(cause))
    assert found["none"] > 0.3
    assert found[cause.label] > 0.3
    assert found["grey"] < 0.1


def test_what_need_not_be_measured_is_grey() -> None:
    assert hues(picture(Cause.COLLISION, measure_low=False))["collision"] < 0.02
    assert hues(picture(Cause.COLLISION, measure_low=False))["grey"] > 0.3


def test_the_two_sides_of_a_thin_plate_do_not_mix() -> None:
    """The top is missed, the bottom and the rims are measured; no pixel of the top may look measured."""
    solid = trimesh.creation.box((0.2, 0.2, 0.001))
    points, face = trimesh.sample.sample_surface(solid, 2000, seed=3)
    normals = np.asarray(solid.face_normals)[face]
    cause = np.where(normals[:, 2] > 0.5, Cause.COLLISION, Cause.NONE).astype(np.int8)
    for two_sided in (False, True):
        png = coverage_picture(
            np.asarray(solid.vertices),
            np.asarray(solid.faces, np.int32),
            np.ones(len(solid.faces), bool),
            np.asarray(points),
            normals,
            cause,
            spacing=0.006,
            two_sided=two_sided,
        )
        found = hues(png)
        assert found["collision"] == pytest.approx(0.75, abs=0.03)  # three of four views look down on it
        assert found["none"] == pytest.approx(0.25, abs=0.03)


def test_every_cause_has_a_colour_of_its_own() -> None:
    assert CAUSE_COLOURS.keys() == set(Cause)
    colours = np.array([rgb(colour) for colour in (*CAUSE_COLOURS.values(), NOT_TO_MEASURE)])
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=-1) + np.eye(len(colours))
    assert apart.min() > 0.1


def test_the_same_data_are_the_same_picture() -> None:
    assert picture(Cause.INCIDENCE) == picture(Cause.INCIDENCE)


@pytest.mark.parametrize("size", [(0.1, 0.1, 0.3), (1.0, 0.2, 0.01), (0.001, 0.001, 0.001), (30.0, 20.0, 10.0)])
def test_the_part_fills_pictures_of_one_scale_wherever_it_is(size: tuple[float, float, float]) -> None:
    vertices, faces = box(*size, at=(5.0, -3.0, 1.0))
    cameras = cameras_around(vertices, WAYS, pixels=200)
    assert len({(camera.width, camera.height, camera.scale) for camera in cameras}) == 1
    assert max(cameras[0].width, cameras[0].height) == 200
    pictures = cast_pictures(vertices, faces, cameras)
    extents = np.array([[np.ptp(rows), np.ptp(columns)] for rows, columns in (np.nonzero(p.hit) for p in pictures)])
    assert 185 <= extents.max() <= 199
    for hits in pictures:
        for border in (hits.hit[0], hits.hit[-1], hits.hit[:, 0], hits.hit[:, -1]):
            assert not border.any()


def test_pixels_know_the_point_and_face_they_show() -> None:
    vertices, faces = box(0.2, 0.2, 0.2, at=(1.0, 0.0, 0.0))
    (hits,) = cast_pictures(vertices, faces, cameras_around(vertices, [(0.0, 0.0)], pixels=100))
    seen = hits.point[hits.hit]
    np.testing.assert_allclose(seen[:, 0], 1.1, atol=1e-5)  # the camera looks along -x
    assert np.all(np.abs(seen[:, 1:]) < 0.1 + 1e-5)
    normals = trimesh.Trimesh(vertices, faces, process=False).face_normals
    np.testing.assert_allclose(normals[hits.face[hits.hit]], np.tile([1.0, 0, 0], (len(seen), 1)), atol=1e-12)


def test_a_shell_is_lit_from_both_sides() -> None:
    vertices = np.array([[0.0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
    front: AnyArray = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    cameras = cameras_around(vertices, [(0.0, 0.0)], pixels=50)
    (one,), (other,) = cast_pictures(vertices, front, cameras), cast_pictures(vertices, front[:, ::-1].copy(), cameras)
    np.testing.assert_allclose(one.shade, other.shade, atol=1e-6)
    assert np.all(one.shade[one.hit] > 0.9)


def test_around_the_part_it_is_white() -> None:
    vertices, faces = box(0.2, 0.2, 0.2)
    (hits,) = cast_pictures(vertices, faces, cameras_around(vertices, [(0.5, 0.5)], pixels=60))
    painted = paint(hits, np.zeros((*hits.hit.shape, 3)))
    assert np.all(painted[~hits.hit] == 1.0)
    assert np.all(painted[hits.hit] == 0.0)
