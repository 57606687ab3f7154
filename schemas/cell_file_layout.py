"""The key `layout` of a cell file: what may be moved to shorten the cycle, on which harness, and how long to search."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from cellwright.cell.transforms import inverse
from schemas.cell_file_document import Location
from schemas.cell_file_fields import Section, Text, WholeNumber
from schemas.cell_file_harness import HarnessSection
from schemas.cell_file_messages import did_you_mean

if TYPE_CHECKING:
    from cellwright.cell.harness import Harness
    from schemas.cell_file import CellFile


class LayoutSection(Section):
    """Where else may the part, or the robot's base, stand? Without this key nothing is moved.

    The joints are at zero where the cell file puts it. Their root is its position there, with the axes of the world.
    """

    move: Literal["part", "robot"] = Field(default="part", description="What is moved.")
    harness: HarnessSection = Field(
        description="The joints on which it is moved.", examples=["{planar: {x: [-100 mm, 100 mm]}}"]
    )
    carries: tuple[Text, ...] | None = Field(
        default=None,
        description="Bodies that move along with the part; the one that it rests on if left out.",
        json_schema_extra={"written_as": "list of names"},
    )
    evaluations: WholeNumber = Field(
        default=3000, ge=1, le=1_000_000, description="Placements judged, some milliseconds each."
    )
    stitched: WholeNumber = Field(
        default=6, ge=1, le=100, description="Promising ones of these that are stitched, about a second each."
    )


def carried_bodies(cell: CellFile) -> tuple[str, ...]:
    """Return the names of the bodies that move along with the part; none if the robot is moved."""
    if cell.layout is None or cell.layout.move == "robot":
        return ()
    if cell.layout.carries is not None:
        return cell.layout.carries
    return () if cell.part.rests_on is None else (cell.part.rests_on,)


def layout_harness(cell: CellFile) -> Harness:
    """Return the motion that the cell file permits, in the world: the identity at zero.

    The cell file has a `layout`.
    """
    if cell.layout is None:
        raise ValueError("the cell file has no layout")
    pose = cell.robot.base if cell.layout.move == "robot" else cell.part.pose
    T_world_root = np.eye(4)
    T_world_root[:3, 3] = pose.pose().position_m
    harness = cell.layout.harness.harness(T_world_root)
    # offsets between the joints are taken back too, so that nothing moves at zero
    at_zero = inverse(harness.poses(np.zeros(harness.n_joints)))
    return cell.layout.harness.harness(T_world_root, at_zero)


def layout_faults(cell: CellFile) -> list[tuple[Location, str]]:
    """Find what in `layout` does not go together with the rest of the cell file."""
    layout = cell.layout
    if layout is None:
        return []
    faults: list[tuple[Location, str]] = []
    for number, element in enumerate(layout.harness.elements()):
        if element.limits is not None and not element.limits[0] <= 0.0 <= element.limits[1]:
            where: Location = ("planar", str(element.name)) if layout.harness.planar else ("joints", number, "range")
            faults.append(
                (("layout", "harness", *where), "leaves zero out, which is where it stands now: let the range hold it")
            )
    if layout.move == "robot" and layout.carries is not None:
        faults.append((("layout", "carries"), "is given, but the robot is moved: remove it, or write move: part"))
    names = [body.name for body in cell.bodies()]
    for number, name in enumerate(layout.carries or ()):
        if name not in names:
            mend = did_you_mean(name, names) if names else "the cell has none"
            faults.append((("layout", "carries", number), f"{name!r} is no body of the cell: {mend}"))
    if layout.move == "part" and layout.carries is None and cell.part.rests_on is None:
        faults.append(
            (
                ("layout",),
                "moves a part that rests on nothing: say part.rests_on, name in carries what moves along with it, or "
                "write carries: [] to move it alone",
            )
        )
    return faults
