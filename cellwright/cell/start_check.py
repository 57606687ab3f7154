"""Whether the robot may stand where its motion starts: said before any long search, the same everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cellwright.errors import InvalidInputError

if TYPE_CHECKING:
    from cellwright.cell.scene import Scene


def check_start(scene: Scene, clearance: float) -> None:
    """Refuse a cell in which two bodies come closer at the start than ``clearance`` m, for which the scene is made.

    Raises:
        InvalidInputError: With the names of the two.
    """
    touching = scene.colliding_pair(scene.cell.start)
    if touching is not None:
        raise InvalidInputError(
            f"the start configuration brings {touching[0]} and {touching[1]} closer than {1e3 * clearance:.4g} mm: "
            "choose another start_rad, move the part, or lower clearance_m"
        )
