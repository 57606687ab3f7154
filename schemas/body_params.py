"""Rigid bodies as stage parameters: named boxes, cylinders, spheres, capsules and mesh files with their poses."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, field_validator

from schemas.params import Params
from schemas.poses import Pose


class _Body(Params):
    name: str = Field(min_length=1, description="Unique name, for messages and pictures.")
    pose: Pose = Field(
        default=Pose(), description="Pose of the body: of housing on the flange, of everything else in the world."
    )


class BoxBody(_Body):
    """A solid box centred on its frame."""

    shape: Literal["box"] = "box"
    size_m: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = Field(description="Edge lengths in m.")


class CylinderBody(_Body):
    """A solid cylinder about z, centred."""

    shape: Literal["cylinder"] = "cylinder"
    radius_m: PositiveFloat = Field(description="Radius in m.")
    length_m: PositiveFloat = Field(description="Length in m.")


class SphereBody(_Body):
    """A solid sphere."""

    shape: Literal["sphere"] = "sphere"
    radius_m: PositiveFloat = Field(description="Radius in m.")


class CapsuleBody(_Body):
    """A solid capsule about z, centred."""

    shape: Literal["capsule"] = "capsule"
    radius_m: PositiveFloat = Field(description="Radius in m.")
    length_m: PositiveFloat = Field(description="Length without the two caps, in m.")


class MeshBody(_Body):
    """A mesh file; solid if it is closed, else a shell."""

    shape: Literal["mesh"] = "mesh"
    file: str = Field(min_length=1, description="Name of the mesh file, without folder.")
    scale: tuple[float, float, float] = Field(
        default=(1.0, 1.0, 1.0), description="Factors from the file's unit to m along x, y, z; negative ones mirror."
    )

    @field_validator("scale")
    @classmethod
    def _not_flat(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if 0.0 in value:
            raise ValueError(f"scale {value} flattens the mesh: give three numbers other than 0")
        return value


BodyParams = Annotated[
    BoxBody | CylinderBody | SphereBody | CapsuleBody | MeshBody, Field(discriminator="shape", description="A body.")
]
