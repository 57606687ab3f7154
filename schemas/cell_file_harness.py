"""A harness in a cell file: the design joints on which a station, the workpiece or the robot's base may be moved.

A list of joints says it in general; `planar` is short for two slides and a turn on the floor. Offsets between joints
make the other mechanisms of Baumgaertner 2025: a turn and an offset keep a fixed distance, a slide behind a turned
offset follows a wall. `docs/layout.md` shows each.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator
from pydantic.config import JsonDict

from cellwright import quantities
from cellwright.arrays import FloatArray
from schemas.cell_file_fields import LONGEST_M, Number, PoseSection, Quantity, Section, Text, fault

if TYPE_CHECKING:
    from cellwright.cell.harness import Harness

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SHORTEST_AXIS = 1e-9
_KINDS = ("slide", "turn", "offset")
_LENGTH = Quantity(quantities.LENGTH, least=-LONGEST_M, most=LONGEST_M)
_ANGLE = Quantity(quantities.ANGLE, least=-2.0 * np.pi, most=2.0 * np.pi)


def _axis(value: object) -> object:
    """Read an axis by its name or as a direction."""
    if isinstance(value, str) and value in _AXES:
        return _AXES[value]
    if not isinstance(value, list | tuple):
        raise fault(f"{value!r} is not an axis: write x, y, z or a direction like [1, 1, 0]")
    if len(value) != 3:
        raise fault(f"has {len(value)} entries but a direction has 3: write x, y, z or [dx, dy, dz]")
    direction = [Quantity(quantities.NUMBER).read(entry) for entry in value]
    if not math.hypot(*direction) > _SHORTEST_AXIS:
        raise fault(f"{list(value)} has no direction: write x, y, z or one like [1, 1, 0]")
    if not math.hypot(*direction) < 1.0 / _SHORTEST_AXIS:
        raise fault(f"{list(value)} is too long for a direction: write x, y, z or one like [1, 1, 0]")
    return tuple(direction)


def _range(value: object, quantity: Quantity) -> tuple[float, float]:
    """Read a range whose ends both carry a unit, and refuse one in which nothing can move."""
    example = "[-90 deg, 90 deg]" if quantity is _ANGLE else "[-200 mm, 200 mm]"
    if not isinstance(value, list | tuple):
        raise fault(f"{value!r} is not a range: write its two ends, like {example}")
    if len(value) != 2:
        raise fault(f"has {len(value)} entries but a range has two ends: write it like {example}")
    low, high = (quantity.read(end) for end in value)
    factor, unit = (180.0 / np.pi, "deg") if quantity is _ANGLE else (1e3, "mm")
    if low == high:
        raise fault(
            f"is empty, from {value[0]} to {value[1]}, 0 {unit} wide: any width above that makes it a range, or leave "
            "it out to hold still"
        )
    if low > high:
        raise fault(
            f"is reversed, from {value[0]} to {value[1]}, its lower end {factor * (low - high):.6g} {unit} above its "
            f"upper end: write [{value[1]}, {value[0]}]"
        )
    return low, high


def _joint_range(value: object, info: ValidationInfo) -> object:
    """Read a joint's range: lengths if it slides, angles if it turns."""
    if value is None or not {"slide", "turn"} & info.data.keys():
        return value
    kinds = [quantity for key, quantity in (("slide", _LENGTH), ("turn", _ANGLE)) if info.data.get(key) is not None]
    return _range(value, kinds[0]) if len(kinds) == 1 else None  # else it is refused for its kind


Axis = Annotated[tuple[Number, Number, Number], BeforeValidator(_axis)]
LengthRange = Annotated[tuple[float, float], BeforeValidator(lambda value: _range(value, _LENGTH))]
AngleRange = Annotated[tuple[float, float], BeforeValidator(lambda value: _range(value, _ANGLE))]

_AXIS_AS: JsonDict = {"written_as": "`x`, `y`, `z` or list of 3 numbers"}
_LENGTHS_AS: JsonDict = {"written_as": "list of 2 lengths"}
_ANGLES_AS: JsonDict = {"written_as": "list of 2 angles"}


class DesignJointSection(Section):
    """One element of a harness: a joint that slides or turns, or a fixed offset to the next one."""

    name: Text | None = Field(default=None, description="Name of the joint; kind and axis if left out.")
    slide: Axis | None = Field(default=None, description="Axis along which it slides.", json_schema_extra=_AXIS_AS)
    turn: Axis | None = Field(default=None, description="Axis about which it turns.", json_schema_extra=_AXIS_AS)
    limits: Annotated[tuple[float, float] | None, BeforeValidator(_joint_range)] = Field(
        default=None,
        alias="range",
        description="From where to where it moves; lengths if it slides, angles if it turns.",
        json_schema_extra={"written_as": "list of 2 lengths or 2 angles"},
    )
    offset: PoseSection | None = Field(default=None, description="Pose of what follows, instead of a joint.")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = [key for key in _KINDS if getattr(self, key) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "nothing that moves"
            raise fault(f"an element of a harness has {found}: give it one of {', '.join(_KINDS)}")
        if self.offset is None and self.limits is None:
            example = "[-90 deg, 90 deg]" if self.turn is not None else "[-200 mm, 200 mm]"
            raise fault(f"a joint that {given[0]}s has no range: write range: {example}")
        if self.offset is not None and self.limits is not None:
            raise fault("an offset does not move, but a range is given: remove one of them")
        if self.offset is not None and len(self.offset.position_m) != 3:
            raise fault("offset has 2 entries in position but needs 3: write [x, y, z]")
        return self

    @property
    def axis(self) -> tuple[float, float, float] | None:
        """The axis along or about which it moves, ``None`` for an offset."""
        return self.slide if self.slide is not None else self.turn


class PlanarSection(Section):
    """Two slides along the axes x and y and a turn about z; what is left out holds still."""

    x_m: LengthRange | None = Field(
        default=None, alias="x", description="Range along x.", json_schema_extra=_LENGTHS_AS
    )
    y_m: LengthRange | None = Field(
        default=None, alias="y", description="Range along y.", json_schema_extra=_LENGTHS_AS
    )
    yaw_rad: AngleRange | None = Field(
        default=None, alias="yaw", description="Range of the turn about z.", json_schema_extra=_ANGLES_AS
    )

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.x_m is None and self.y_m is None and self.yaw_rad is None:
            raise fault("planar has no range: give it at least one of x, y, yaw")
        return self


class HarnessSection(Section):
    """The design joints on which something may be moved: `planar`, or a list of `joints` from the world on."""

    planar: PlanarSection | None = Field(default=None, description="Two slides and a turn on the floor.")
    joints: tuple[DesignJointSection, ...] = Field(
        default=(),
        max_length=24,
        description="Joints and offsets, each carrying the next.",
        json_schema_extra={"written_as": "list of joints"},
    )

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.planar is not None and self.joints:
            raise fault("planar and joints are both given: keep one")
        if self.planar is None and all(joint.offset is not None for joint in self.joints):
            raise fault("a harness has no joint that moves: give it planar or joints with a range")
        names = [joint.name for joint in self.joints if joint.name is not None]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise fault(f"two joints are named {twice!r}: give each its own name")
        return self

    def elements(self) -> tuple[DesignJointSection, ...]:
        """Return joints and offsets in order, those of `planar` written out."""
        if self.planar is None:
            return self.joints
        return tuple(
            DesignJointSection.model_construct(
                name=name,
                limits=limits,
                slide=None if name == "yaw" else _AXES[name],
                turn=_AXES["z"] if name == "yaw" else None,
            )
            for name, limits in (("x", self.planar.x_m), ("y", self.planar.y_m), ("yaw", self.planar.yaw_rad))
            if limits is not None
        )

    def harness(self, T_world_root: FloatArray | None = None, T_last_carried: FloatArray | None = None) -> Harness:
        """Return the library's harness.

        Args:
            T_world_root: Where the first joint sits, (4, 4); the world's origin if left out.
            T_last_carried: Pose of what is carried on the last joint or offset, (4, 4); the identity if left out.
        """
        from cellwright.cell.harness import DesignJoint, Harness

        T = np.eye(4) if T_world_root is None else np.array(T_world_root, float)
        joints: list[DesignJoint] = []
        taken = {element.name for element in self.elements()}
        for element in self.elements():
            if element.offset is not None:
                T = T @ element.offset.matrix()
            elif element.axis is not None and element.limits is not None:
                name = element.name or _free_name(element, taken)
                taken.add(name)
                joints.append(DesignJoint(name, element.turn is not None, np.array(element.axis), *element.limits, T))
                T = np.eye(4)
        return Harness(tuple(joints), T if T_last_carried is None else T @ T_last_carried)


def _free_name(element: DesignJointSection, taken: set[str | None]) -> str:
    """Name a joint after kind and axis, with a number where that is taken."""
    kind = "turn" if element.turn is not None else "slide"
    letter = next((letter for letter, axis in _AXES.items() if axis == element.axis), "")
    stem = f"{kind} {letter}".strip()
    names = [stem, *(f"{stem} {number}" for number in range(2, len(taken) + 3))]
    return next(name for name in names if name not in taken)
