"""Shaded pictures of a coloured triangle mesh, rendered by casting one ray a pixel.

Needs no window system and no graphics card; the same mesh, colours and camera give the same pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array


@dataclass(frozen=True)
class Camera:
    """An orthographic camera that looks at a mesh's centre.

    Attributes:
        azimuth: Angle about z from x to the camera, rad.
        elevation: Angle above the xy plane, rad.
        width, height: Picture size in pixels.
    """

    azimuth: float
    elevation: float
    width: int = 640
    height: int = 560


@dataclass(frozen=True, eq=False)
class PixelHits:
    """What the rays of a picture hit.

    Attributes:
        hit: Whether the pixel shows the mesh, (height, width).
        face: Face hit, (height, width); undefined where nothing is hit.
        point: Point hit, (height, width, 3).
        shade: Brightness by the angle between face and camera, 0 to 1, (height, width).
    """

    hit: BoolArray
    face: Int32Array
    point: FloatArray
    shade: FloatArray


def cast_picture(vertices: FloatArray, faces: Int32Array, camera: Camera) -> PixelHits:
    """Cast one ray a pixel at a mesh (vertices (n, 3), faces (m, 3)) that fills the picture."""
    import open3d as o3d

    towards = np.array(
        [
            np.cos(camera.elevation) * np.cos(camera.azimuth),
            np.cos(camera.elevation) * np.sin(camera.azimuth),
            np.sin(camera.elevation),
        ]
    )
    right = np.array([-np.sin(camera.azimuth), np.cos(camera.azimuth), 0.0])
    up = np.cross(towards, right)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    flat = (vertices - centre) @ np.stack([right, up, towards]).T
    scale = 1.06 * max(2 * np.abs(flat[:, 0]).max() / camera.width, 2 * np.abs(flat[:, 1]).max() / camera.height)
    x = (np.arange(camera.width) - (camera.width - 1) / 2) * scale
    y = ((camera.height - 1) / 2 - np.arange(camera.height)) * scale
    depth = 1.1 * np.abs(flat[:, 2]).max() + scale
    origins = x[None, :, None] * right + y[:, None, None] * up + depth * towards
    rays = np.concatenate([origins, np.broadcast_to(-towards, origins.shape)], axis=-1).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor((vertices - centre).astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    cast = scene.cast_rays(o3d.core.Tensor(rays))
    distance = cast["t_hit"].numpy()
    hit = np.isfinite(distance)
    normal = cast["primitive_normals"].numpy()
    shade = 0.35 + 0.65 * np.abs(normal @ towards.astype(np.float32))
    point = origins - np.where(hit, distance, 0.0)[..., None] * towards + centre
    face = np.where(hit, cast["primitive_ids"].numpy(), 0).astype(np.int32)
    return PixelHits(hit, face, point, np.where(hit, shade, 0.0))


def paint(hits: PixelHits, colours: FloatArray) -> FloatArray:
    """Return an RGB picture (height, width, 3), 0 to 1: pixel colours (height, width, 3) shaded, white around."""
    return np.where(hits.hit[..., None], colours * hits.shade[..., None], 1.0)
