"""Shaded pictures of a coloured triangle mesh, rendered by casting one ray a pixel.

Needs no window system and no graphics card; the same mesh, colours and camera give the same pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array, IntArray

_BORDER = 1.04
"""Pictures are larger than the mesh by this factor."""

_AMBIENT = 0.6
"""Brightness of a face that no light falls on: its colour must still be told from the others."""


@dataclass(frozen=True)
class Camera:
    """An orthographic camera that looks at a mesh's centre.

    Attributes:
        azimuth: Angle about z from x to the camera, rad.
        elevation: Angle above the xy plane, rad.
        width, height: Picture size in pixels.
        scale: Size of a pixel in m.
    """

    azimuth: float
    elevation: float
    width: int
    height: int
    scale: float

    def axes(self) -> FloatArray:
        """Return the unit vectors to the right, up, and from the mesh to the camera, (3, 3)."""
        return _axes(self.azimuth, self.elevation)


@dataclass(frozen=True, eq=False)
class PixelHits:
    """What the rays of a picture hit.

    Attributes:
        hit: Whether the pixel shows the mesh, (height, width).
        face: Face hit, (height, width); undefined where nothing is hit.
        point: Point hit, (height, width, 3).
        shade: Brightness of the face under a light above the camera, 0 to 1, (height, width).
    """

    hit: BoolArray
    face: Int32Array
    point: FloatArray
    shade: FloatArray


def cameras_around(vertices: FloatArray, directions: Sequence[tuple[float, float]], pixels: int = 640) -> list[Camera]:
    """Return a camera for each direction (azimuth, elevation) in rad: pictures of one size and one scale.

    The mesh's largest extent in any of them takes ``pixels``; the shorter side of the pictures is as long as needed.
    """
    middle = _centre(vertices)
    extents = np.array([2 * np.abs((vertices - middle) @ _axes(*way)[:2].T).max(axis=0) for way in directions])
    width, height = extents.max(axis=0) * _BORDER
    scale = float(max(width, height)) / pixels
    n_columns, n_rows = max(1, round(width / scale)), max(1, round(height / scale))
    return [Camera(*way, n_columns, n_rows, scale) for way in directions]


def camera_on(points: FloatArray, way: tuple[float, float], pixels: tuple[int, int]) -> Camera:
    """Return a camera whose picture of a given width and height holds all points, their box's middle in its middle."""
    extents = 2 * np.abs((points - _centre(points)) @ _axes(*way)[:2].T).max(axis=0)
    scale = float((extents / np.array(pixels)).max()) * _BORDER
    return Camera(*way, *pixels, max(scale, 1e-9))


def cast_pictures(
    vertices: FloatArray, faces: IntArray | Int32Array, cameras: Sequence[Camera], *, middle: FloatArray | None = None
) -> list[PixelHits]:
    """Cast one ray a pixel at a mesh, vertices (n, 3) in m and faces (m, 3), for each camera.

    Cameras look at ``middle`` (3,), the middle of the mesh's box if left out.
    """
    import open3d as o3d

    middle = _centre(vertices) if middle is None else middle
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor((vertices - middle).astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    distance_away = 1.1 * float(np.linalg.norm(vertices - middle, axis=1).max())
    pictures = []
    for camera in cameras:
        right, up, towards = camera.axes()
        x = (np.arange(camera.width) - (camera.width - 1) / 2) * camera.scale
        y = ((camera.height - 1) / 2 - np.arange(camera.height)) * camera.scale
        origins = x[None, :, None] * right + y[:, None, None] * up + distance_away * towards
        rays = np.concatenate([origins, np.broadcast_to(-towards, origins.shape)], axis=-1).astype(np.float32)
        cast = scene.cast_rays(o3d.core.Tensor(rays))
        distance = cast["t_hit"].numpy()
        hit = np.isfinite(distance)
        light = (towards + 0.2 * up + 0.15 * right).astype(np.float32)
        light /= np.linalg.norm(light)
        # a face seen from behind is lit like its front: shells have no inside
        facing = cast["primitive_normals"].numpy()
        facing *= np.where(facing @ towards.astype(np.float32) < 0, -1, 1)[..., None]
        shade = _AMBIENT + (1 - _AMBIENT) * np.clip(facing @ light, 0, 1)
        point = origins - np.where(hit, distance, 0.0)[..., None] * towards + middle
        face = np.where(hit, cast["primitive_ids"].numpy(), 0).astype(np.int32)
        pictures.append(PixelHits(hit, face, point, np.where(hit, shade, 0.0)))
    return pictures


def hidden_points(
    vertices: FloatArray, faces: IntArray | Int32Array, points: FloatArray, towards: FloatArray
) -> BoolArray:
    """Tell which points (n, 3) a mesh hides from a viewer far away ``towards`` (3,), unit length: (n,)."""
    import open3d as o3d

    middle = _centre(vertices)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor((vertices - middle).astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    rays = np.hstack([points - middle, np.broadcast_to(towards, points.shape)]).astype(np.float32)
    return np.asarray(scene.test_occlusions(o3d.core.Tensor(rays)).numpy(), bool)


def paint(hits: PixelHits, colours: FloatArray) -> FloatArray:
    """Return an RGB picture (height, width, 3), 0 to 1: pixel colours (height, width, 3) shaded, white around."""
    return np.where(hits.hit[..., None], colours * hits.shade[..., None], 1.0)


def _axes(azimuth: float, elevation: float) -> FloatArray:
    c, s = np.cos(elevation), np.sin(elevation)
    towards = np.array([c * np.cos(azimuth), c * np.sin(azimuth), s])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def _centre(vertices: FloatArray) -> FloatArray:
    return np.asarray((vertices.min(axis=0) + vertices.max(axis=0)) / 2)
