"""Rigid bodies of the cell: a shape, its pose, and what moves it."""

from __future__ import annotations

from dataclasses import dataclass

from cellwright.arrays import FloatArray, Int32Array

WORLD = -1
"""Parent of bodies that stand in the world."""
BASE = 0
"""Parent of bodies fixed to the robot's base; ``i`` is the link behind joint ``i``, the tool's the last."""


@dataclass(frozen=True)
class Box:
    """A solid box, centred on its body frame; ``size``: edge lengths (3,) in m."""

    size: tuple[float, float, float]


@dataclass(frozen=True)
class Cylinder:
    """A solid cylinder about the body's z axis, centred; radius and length in m."""

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A solid sphere about the body's origin; radius in m."""

    radius: float


@dataclass(frozen=True)
class Capsule:
    """A solid capsule about the body's z axis, centred; ``length`` without the two caps, in m."""

    radius: float
    length: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh; vertices (n, 3) in m, faces (m, 3). Solid if it is closed, else a shell."""

    vertices: FloatArray
    faces: Int32Array


Shape = Box | Cylinder | Sphere | Capsule | Mesh


@dataclass(frozen=True, eq=False)
class Body:
    """A named shape at ``T_parent_body`` (4, 4) on its parent: ``WORLD``, ``BASE`` or a link number."""

    name: str
    shape: Shape
    parent: int
    T_parent_body: FloatArray
