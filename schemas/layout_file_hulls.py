"""Solids of a layout file that must not be touched: hulls of stations and tool, and obstacles."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from schemas.cell_file_fields import (
    BodySection,
    BoxSection,
    Length,
    MeshSection,
    PoseSection,
    PositiveLength,
    RodSection,
    Section,
    SphereSection,
    WholeNumber,
    fault,
)

MOST_SPHERES = 512
"""Of one hull."""
MOST_SPHERES_IN_ALL = 4096
"""Every pair of them is looked at, which takes as many bytes as there are pairs."""

_SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh", "spheres")


class BallSection(Section):
    """One sphere of a hull."""

    centre_m: tuple[Length, Length, Length] = Field(
        alias="centre", description="Centre on the station, a tool's on the flange."
    )
    radius_m: PositiveLength = Field(alias="radius", description="Radius.")


class HullSection(Section):
    """A solid that must not be touched, covered with spheres: one shape, or the spheres themselves."""

    box: BoxSection | None = Field(default=None, description="A box.")
    cylinder: RodSection | None = Field(default=None, description="A cylinder.")
    sphere: SphereSection | None = Field(default=None, description="A sphere.")
    capsule: RodSection | None = Field(default=None, description="A capsule.")
    mesh: MeshSection | None = Field(default=None, description="A mesh from a file.")
    spheres: tuple[BallSection, ...] | None = Field(default=None, description="The spheres themselves.")
    pose: PoseSection = Field(
        default=PoseSection(), description="Pose of the shape on the station, a tool's on the flange."
    )
    count: WholeNumber = Field(
        default=8, ge=1, le=MOST_SPHERES, description="Spheres that cover the shape, proven to hold it."
    )
    cells: tuple[WholeNumber, WholeNumber, WholeNumber] | None = Field(
        default=None, description="Cells of a box along x, y, z, a sphere about each, instead of `count`."
    )

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        given = [name for name in _SHAPES if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "no shape"
            raise fault(f"a hull has {found}: give it one of {', '.join(_SHAPES)}")
        if self.cells is not None and (self.box is None or min(self.cells) < 1):
            raise fault("cells divide a box: give positive numbers, and only with a box")
        if self.n_spheres > MOST_SPHERES:
            raise fault(f"a hull has {self.n_spheres} spheres: {MOST_SPHERES} is the most that it may have: use fewer")
        if len(self.pose.position_m) != 3:
            raise fault("pose has 2 entries in position but needs 3: write [x, y, z]")
        return self

    @property
    def n_spheres(self) -> int:
        """The number of spheres that it becomes, or is covered with."""
        if self.spheres is not None:
            return len(self.spheres)
        if self.sphere is not None:
            return 1
        return self.count if self.cells is None else math.prod(self.cells)


class LayoutObstacleSection(BodySection):
    """Something that stands still and is in the way."""

    count: WholeNumber = Field(
        default=8, ge=1, le=MOST_SPHERES, description="Spheres that cover it, proven to hold it."
    )
