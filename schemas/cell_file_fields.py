"""The kinds of values in a cell file: quantities, paths, poses and bodies, each checked where it is written."""

from __future__ import annotations

import math
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationInfo,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from cellwright import quantities
from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Shape, Sphere
from cellwright.cell.transforms import quaternion_from_rotation, rotation_from_rpy
from cellwright.errors import InvalidInputError
from cellwright.quantities import Dimension
from schemas.poses import Pose

MESH_SUFFIXES = (".stl", ".ply", ".obj", ".3mf", ".step", ".stp")
"""File types of parts and bodies."""

Unit = Literal["um", "mm", "cm", "m", "in", "ft"]

_LARGEST_ANGLE = math.radians(3600.0)
"""Rad: ten turns; more is a slip of the unit."""


def fault(message: str) -> PydanticCustomError:
    """Make a validation error whose message is shown as it is."""
    return PydanticCustomError("cell_file", "{message}", {"message": message})


@dataclass(frozen=True)
class Quantity:
    """Type annotation: a quantity with a unit in the file, its SI value in the model.

    Attributes:
        dimension: What it measures.
        above: The SI value must be greater than this.
        least: The SI value must be at least this.
        most: The SI value must be at most this.
    """

    dimension: Dimension
    above: float | None = None
    least: float | None = None
    most: float | None = None

    def read(self, value: object) -> float:
        """Parse and check one value."""
        try:
            si = quantities.parse_quantity(value, self.dimension)
        except InvalidInputError as error:
            raise fault(str(error)) from error
        slack = 1e-12 * max(1.0, abs(si))  # a bound that was itself converted must not reject its own text
        if self.above is not None and si <= self.above:
            raise fault(f"{value!r} must be above {self._written(self.above)}: write a larger value")
        if self.least is not None and si < self.least - slack:
            raise fault(f"{value!r} must be at least {self._written(self.least)}: write a larger value")
        if self.most is not None and si > self.most + slack:
            percents = self.dimension is quantities.SHARE and not isinstance(value, str) and 2.0 <= si <= 100.0
            hint = f": write {value} %" if percents else ""
            raise fault(f"{value!r} must be at most {self._written(self.most)}{hint or ': write a smaller value'}")
        return si

    def _written(self, bound: float) -> str:
        return "0" if bound == 0 else quantities.format_quantity(bound, self.dimension)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))


LONGEST_M = 1000.0
"""No cell is longer; further out, positions lose the digits that collision checks need."""

Length = Annotated[float, Quantity(quantities.LENGTH, least=-LONGEST_M, most=LONGEST_M)]
PositiveLength = Annotated[float, Quantity(quantities.LENGTH, above=0.0, most=LONGEST_M)]
NonNegativeLength = Annotated[float, Quantity(quantities.LENGTH, least=0.0, most=LONGEST_M)]
Uncertainty = Annotated[float, Quantity(quantities.FINE_LENGTH, least=0.0, most=LONGEST_M)]
PositiveUncertainty = Annotated[float, Quantity(quantities.FINE_LENGTH, above=0.0, most=LONGEST_M)]
Angle = Annotated[float, Quantity(quantities.ANGLE, least=-_LARGEST_ANGLE, most=_LARGEST_ANGLE)]
AcuteAngle = Annotated[float, Quantity(quantities.ANGLE, least=0.0, most=math.radians(89.9))]
Incidence = Annotated[float, Quantity(quantities.ANGLE, above=0.0, most=math.radians(89.9))]
# finer than these, the states of a motion no longer fit into memory
SmallAngle = Annotated[float, Quantity(quantities.ANGLE, least=math.radians(0.05), most=math.radians(10.0))]
Aperture = Annotated[float, Quantity(quantities.ANGLE, above=0.0, most=math.radians(170.0))]
Tilt = Annotated[float, Quantity(quantities.ANGLE, least=math.radians(-89.0), most=math.radians(89.0))]
Duration = Annotated[float, Quantity(quantities.TIME, above=0.0, most=7 * 86_400.0)]
# slower than these, a plan takes hours and its states no longer fit into memory; no robot is faster, and squares of
# what is far beyond overflow
Speed = Annotated[float, Quantity(quantities.SPEED, least=1e-3, most=100.0)]
Acceleration = Annotated[float, Quantity(quantities.ACCELERATION, least=1e-3, most=1e4)]
AngularSpeed = Annotated[float, Quantity(quantities.ANGULAR_SPEED, least=math.radians(0.1), most=math.radians(1e5))]
AngularAcceleration = Annotated[
    float, Quantity(quantities.ANGULAR_ACCELERATION, least=math.radians(0.1), most=math.radians(1e7))
]
Frequency = Annotated[float, Quantity(quantities.FREQUENCY, above=0.0, most=1e6)]
# a sample for each square of 10 um: finer than any scanner, and beyond what can be handled on the smallest part
Density = Annotated[float, Quantity(quantities.AREAL_DENSITY, above=0.0, most=1e10)]
Share = Annotated[float, Quantity(quantities.SHARE, above=0.0, most=1.0)]
# a nanosecond each: twelve days
Work = Annotated[float, Quantity(quantities.NUMBER, above=0.0, most=1e15)]
Scale = Annotated[float, Quantity(quantities.NUMBER, above=0.0, most=1e9)]
DensityFactor = Annotated[float, Quantity(quantities.NUMBER, above=0.0, most=1e6)]
Number = Annotated[float, Quantity(quantities.NUMBER)]


def _text(value: object) -> object:
    """Take a number as the name it was meant to be: `name: 12`."""
    if isinstance(value, str) and not value.replace("\n", " ").isprintable():
        raise fault(f"{value!r} holds characters that cannot be printed: remove them")
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


Text = Annotated[str, BeforeValidator(_text), Field(min_length=1, max_length=200)]


def resolved(value: object, info: ValidationInfo) -> Path:
    """Read a path, relative to the cell file's folder."""
    if not isinstance(value, str | Path) or not str(value).strip():
        raise fault(f"{value!r} is not a path: write the path of a file")
    folder = Path((info.context or {}).get("folder", "."))
    try:
        return folder / Path(value).expanduser()
    except RuntimeError as error:  # ~somebody
        raise fault(f"{value!r} names the home folder of somebody unknown here: write the whole path") from error


def existing_file(path: Path, suffixes: tuple[str, ...]) -> Path:
    """Check that a file exists and is of a known type."""
    if path.suffix.lower() not in suffixes:
        shown = f"type {path.suffix!r}" if path.suffix else "no file type"
        raise fault(f"{str(path)!r} has {shown}: use one of {', '.join(suffixes)}")
    try:
        kind = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        near = "" if path.parent.is_dir() else f" (nor does the folder {path.parent})"
        raise fault(f"{str(path)!r} does not exist{near}: paths are relative to the cell file") from error
    except (OSError, ValueError) as error:
        raise fault(
            f"{_cut(path)!r} cannot be opened ({getattr(error, 'strerror', None) or error}): check it"
        ) from error
    if stat.S_ISDIR(kind):
        raise fault(f"{str(path)!r} is a folder: name the file in it")
    if not stat.S_ISREG(kind):
        raise fault(f"{str(path)!r} is not a regular file (a device or a pipe?): name a file")
    return path


def _cut(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _mesh_file(value: object, info: ValidationInfo) -> Path:
    return existing_file(resolved(value, info), MESH_SUFFIXES)


def _folder(value: object, info: ValidationInfo) -> Path:
    path = resolved(value, info)
    try:
        is_folder = path.is_dir()
    except OSError as error:
        raise fault(f"{_cut(path)!r} cannot be opened ({error.strerror or error}): check it") from error
    if not is_folder:
        raise fault(f"{str(path)!r} is no folder: paths are relative to the cell file")
    return path


MeshFile = Annotated[Path, BeforeValidator(_mesh_file)]
Folder = Annotated[Path, BeforeValidator(_folder)]


def _whole_number(value: object) -> object:
    """Refuse what YAML reads as true or false; Python counts with them."""
    if isinstance(value, bool):
        raise fault(f"{str(value).lower()} is not a whole number: write one without unit")
    return value


WholeNumber = Annotated[int, BeforeValidator(_whole_number)]


class Section(BaseModel):
    """A section of a cell file: its keys are the aliases of its fields, its values are SI."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PoseSection(Section):
    """Where a frame stands in its parent."""

    position_m: tuple[Length, ...] = Field(
        default=(0.0, 0.0, 0.0),
        alias="position",
        description="x, y, z in the parent frame; x, y alone where `rests_on` finds z.",
    )
    rotation_rad: tuple[Angle, Angle, Angle] | None = Field(
        default=None, alias="rotation", description="Roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll), as in a URDF."
    )
    quaternion: tuple[Number, Number, Number, Number] | None = Field(
        default=None, description="Orientation (w, x, y, z), instead of `rotation`."
    )

    @model_validator(mode="after")
    def _one_rotation(self) -> Self:
        if len(self.position_m) not in (2, 3):
            raise fault(f"position has {len(self.position_m)} entries but needs 3: write [x, y, z]")
        if self.rotation_rad is not None and self.quaternion is not None:
            raise fault("rotation and quaternion are both given: keep one")
        if self.quaternion is not None and abs(math.hypot(*self.quaternion) - 1.0) > 1e-3:
            raise fault(f"quaternion has length {math.hypot(*self.quaternion):.6g}: scale it to 1")
        return self

    def pose(self) -> Pose:
        """Return the pose; a missing height counts as 0."""
        if self.quaternion is not None:
            quaternion = np.array(self.quaternion) / math.hypot(*self.quaternion)
        else:
            quaternion = quaternion_from_rotation(rotation_from_rpy(*(self.rotation_rad or (0.0, 0.0, 0.0))))
        x, y, z = (*self.position_m, 0.0)[:3]
        w, i, j, k = quaternion.tolist()
        return Pose(position_m=(x, y, z), quaternion=(w, i, j, k))

    def matrix(self) -> FloatArray:
        """Return the pose as a 4x4 matrix."""
        return self.pose().matrix()


class BoxSection(Section):
    """A solid box, centred on its pose."""

    size_m: tuple[PositiveLength, PositiveLength, PositiveLength] = Field(
        alias="size", description="Edge lengths along x, y, z."
    )


class RodSection(Section):
    """A solid cylinder or capsule about its z axis, centred on its pose."""

    radius_m: PositiveLength = Field(alias="radius", description="Radius.")
    length_m: PositiveLength = Field(alias="length", description="Length along z; of a capsule without its caps.")


class SphereSection(Section):
    """A solid sphere."""

    radius_m: PositiveLength = Field(alias="radius", description="Radius.")


class MeshSection(Section):
    """A body from a file."""

    file: MeshFile = Field(description="STL, PLY, OBJ, 3MF or STEP file.")
    unit: Unit | None = Field(default=None, description="Unit of the file; STEP and 3MF carry their own, else mm.")
    scale: Scale = Field(default=1.0, description="Factor on the size.")


class BodySection(Section):
    """A rigid body: one shape and where it stands."""

    name: Text = Field(description="Name of the body, unique in the cell.")
    box: BoxSection | None = Field(default=None, description="A box.")
    cylinder: RodSection | None = Field(default=None, description="A cylinder.")
    sphere: SphereSection | None = Field(default=None, description="A sphere.")
    capsule: RodSection | None = Field(default=None, description="A capsule.")
    mesh: MeshSection | None = Field(default=None, description="A mesh from a file.")
    pose: PoseSection = Field(default=PoseSection(), description="Pose in the world; of housing bodies on the flange.")

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        shapes = ("box", "cylinder", "sphere", "capsule", "mesh")
        given = [name for name in shapes if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "no shape"
            raise fault(f"body {self.name!r} has {found}: give it one of {', '.join(shapes)}")
        if len(self.pose.position_m) != 3:
            raise fault(f"pose of body {self.name!r} has 2 entries in position but needs 3: write [x, y, z]")
        return self

    def shape(self) -> Shape | MeshSection:
        """Return the library's shape, or the section of the mesh file that has yet to be read."""
        if self.box is not None:
            return Box(self.box.size_m)
        if self.cylinder is not None:
            return Cylinder(self.cylinder.radius_m, self.cylinder.length_m)
        if self.capsule is not None:
            return Capsule(self.capsule.radius_m, self.capsule.length_m)
        if self.sphere is not None:
            return Sphere(self.sphere.radius_m)
        if self.mesh is None:
            raise InvalidInputError(f"body {self.name!r} has no shape")
        return self.mesh


class TableSection(BodySection):
    """The table that the part stands on."""

    name: Text = Field(default="table", description="Name of the body.")
