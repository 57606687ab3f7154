"""What must not collide in a layout: hulls of spheres on stations and robot links, and walls as half spaces."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.errors import InvalidInputError

ROBOT_BASE, TOOL = "robot base", "the tool"
"""What messages call the two ends of a robot."""


def frozen(values: FloatArray | list[float] | tuple[float, ...], shape: tuple[int, ...], what: str) -> FloatArray:
    """Return a read-only copy; -1 in ``shape`` stands for any number.

    Raises:
        InvalidInputError: If the shape differs or a value is not finite.
    """
    array = np.array(values, float)
    fits = len(array.shape) == len(shape) and all(want in (-1, have) for want, have in zip(shape, array.shape))
    if not fits and array.size == 0 and -1 in shape:
        array, fits = np.zeros([0 if want == -1 else want for want in shape]), True
    if not fits or not np.isfinite(array).all():
        raise InvalidInputError(f"{what} has shape {array.shape}: give finite numbers of shape {shape} (-1: any)")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Spheres:
    """A hull: centres (k, 3) in m in the frame of what it stands for, and radii (k,) in m."""

    centres: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    radii: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            InvalidInputError: If the shapes do not fit or a radius is negative.
        """
        object.__setattr__(self, "centres", frozen(self.centres, (-1, 3), "a hull's centres"))
        object.__setattr__(self, "radii", frozen(self.radii, (len(self.centres),), "a hull's radii"))
        if len(self.radii) and self.radii.min() < 0.0:
            raise InvalidInputError(f"a hull has the radius {self.radii.min():.6g} m: radii must not be negative")

    def __len__(self) -> int:
        """The number of spheres."""
        return len(self.radii)


@dataclass(frozen=True, eq=False)
class RobotSpheres:
    """Spheres on the robot: ``link`` 0 is the base, i the link behind joint i; centres in the link's frame.

    Attributes:
        link: (m,).
        centres: (m, 3) in m.
        radii: (m,) in m.
        self_pairs: Rows of two spheres that must keep clear of each other, (p, 2).
        body: What each sphere stands for, as a person calls it; the URDF link behind its joint if left out.
    """

    link: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    centres: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    radii: FloatArray = field(default_factory=lambda: np.zeros(0))
    self_pairs: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    body: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            InvalidInputError: If the shapes do not fit, a radius is negative, or a pair names no sphere.
        """
        object.__setattr__(self, "centres", frozen(self.centres, (-1, 3), "the robot's sphere centres"))
        n = len(self.centres)
        object.__setattr__(self, "radii", frozen(self.radii, (n,), "the robot's sphere radii"))
        link = np.array(self.link, np.int64)
        pairs = np.array(self.self_pairs, np.int64).reshape(-1, 2)
        if link.shape != (n,) or (n and (link.min() < 0 or self.radii.min() < 0.0)):
            raise InvalidInputError(f"the robot has {n} sphere centres and links {link.shape}: give one link a sphere")
        if len(pairs) and (pairs.min() < 0 or pairs.max() >= n):
            raise InvalidInputError(f"a pair for self-collision names sphere {pairs.max()}, but there are {n}")
        if self.body and len(self.body) != n:
            raise InvalidInputError(f"{len(self.body)} bodies are named for {n} spheres: name one a sphere, or none")
        link.flags.writeable = pairs.flags.writeable = False
        object.__setattr__(self, "link", link)
        object.__setattr__(self, "self_pairs", pairs)

    def __len__(self) -> int:
        """The number of spheres."""
        return len(self.radii)


def link_name(link: str) -> str:
    """Return what messages call a URDF link."""
    return f"link {link!r}"


def end_effector_point(
    arm: SerialArm, T_flange_tool: FloatArray | None = None, radius_m: float = 0.0, *, base_radius_m: float = 0.0
) -> RobotSpheres:
    """Return the paper's model of the robot: the tool's origin alone, as a sphere of ``radius_m``.

    With ``base_radius_m`` a sphere before it, half its radius above the base, keeps the base free.
    """
    T = arm.T_last_flange if T_flange_tool is None else arm.T_last_flange @ T_flange_tool
    tool = RobotSpheres(np.array([arm.n_joints]), T[None, :3, 3], np.array([radius_m]), body=(TOOL,))
    if base_radius_m == 0.0:
        return tool
    return RobotSpheres(
        np.concatenate([[0], tool.link]),
        np.concatenate([[[0.0, 0.0, 0.5 * base_radius_m]], tool.centres]),
        np.concatenate([[base_radius_m], tool.radii]),
        body=(ROBOT_BASE, TOOL),
    )


def box_hull(size_m: tuple[float, float, float], cells: tuple[int, int, int], centre_m: FloatArray) -> Spheres:
    """Return spheres that contain a box: one about each cell of a grid, half the cell's diagonal as radius."""
    edges = np.array(size_m) / np.array(cells)
    offsets = [(np.arange(n) + 0.5) * edge - 0.5 * length for n, edge, length in zip(cells, edges, size_m)]
    grid = np.stack(np.meshgrid(*offsets, indexing="ij"), axis=-1).reshape(-1, 3)
    return Spheres(grid + np.asarray(centre_m, float), np.full(len(grid), 0.5 * float(np.linalg.norm(edges))))


@dataclass(frozen=True, eq=False)
class Wall:
    """A half space that holds everything: ``normal @ p_world >= offset_m``.

    Attributes:
        name: For messages.
        normal: Unit normal into the room, (3,).
        offset_m: Distance of the wall from the world's origin along the normal.
        holds_robot: Whether the robot must keep off it too: its links, and its base (link 0) if that moves against it.
    """

    name: str
    normal: FloatArray
    offset_m: float
    holds_robot: bool = True

    def __post_init__(self) -> None:
        """Check and normalise.

        Raises:
            InvalidInputError: If the normal has no direction.
        """
        normal = frozen(self.normal, (3,), f"wall {self.name!r}'s normal")
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            raise InvalidInputError(f"wall {self.name!r} has the normal {normal.tolist()}: give it a direction")
        object.__setattr__(self, "normal", frozen(normal / length, (3,), "normal"))


def workspace_walls(lower: FloatArray, upper: FloatArray, *, holds_robot: bool = True) -> tuple[Wall, ...]:
    """Return the six walls of a box from corner ``lower`` to corner ``upper`` (3,); infinite sides are left open.

    Raises:
        InvalidInputError: If the box is empty.
    """
    walls: list[Wall] = []
    for axis, name in enumerate("xyz"):
        low, high = float(lower[axis]), float(upper[axis])
        if low >= high:
            raise InvalidInputError(
                f"the workspace reaches from {low:.6g} to {high:.6g} m in {name}: "
                f"widen it by more than {low - high:.6g} m"
            )
        if math.isfinite(low):
            walls.append(Wall(f"workspace {name} min", np.eye(3)[axis], low, holds_robot))
        if math.isfinite(high):
            walls.append(Wall(f"workspace {name} max", -np.eye(3)[axis], -high, holds_robot))
    return tuple(walls)
