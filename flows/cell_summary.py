"""What a cell file says, for a person who checks it: the cell in a table, quantities in the units people use."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from schemas.cell_file import CellFile


@dataclass(frozen=True, slots=True)
class CellSummary:
    """A checked cell file, ready to be shown; with its picture, if it was drawn, and how everything stands."""

    cell: CellFile
    picture: Path | None = None
    attention: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def as_json(self) -> Mapping[str, Any]:
        """Return the whole cell, defaults filled in, in SI units."""
        return {
            "valid": True,
            "file": str(self.cell.path),
            "cell": self.cell.model_dump(mode="json"),
            **({} if self.picture is None else {"picture": str(self.picture)}),
            "attention": list(self.attention),
            "notes": list(self.notes),
        }

    def show(self, console: Console) -> None:
        """Print what stands where."""
        from rich.table import Table

        table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
        for name, text in self._lines():
            table.add_row(name, text)
        console.print(f"{self.cell.path} is valid", markup=False, highlight=False)
        console.print(table, markup=False, highlight=False)
        if self.picture is not None:
            console.print(f"picture: {self.picture}", markup=False, highlight=False, soft_wrap=True)
        for finding in self.attention:
            console.print(f"Attention: {finding}.", markup=False, highlight=False, soft_wrap=True)
        for note in self.notes:
            console.print(f"Note: {note}.", markup=False, highlight=False, soft_wrap=True)

    def _lines(self) -> Iterator[tuple[str, str]]:
        cell = self.cell
        yield "cell", cell.name
        yield "robot", f"{cell.robot.model} at {place_words(cell.robot.base.matrix()[:3, 3])}"
        standoff = cell.scanner.standoff
        yield (
            "scanner",
            f"{cell.scanner.model}: fan {math.degrees(cell.scanner.aperture_rad):.3g} deg, standoff "
            f"{standoff.min_m * 1e3:.4g} / {standoff.best_m * 1e3:.4g} / {standoff.max_m * 1e3:.4g} mm",
        )
        part = cell.part
        scale = "" if part.scale == 1 else f", scaled by {part.scale:g}"
        standing = f", on {part.rests_on}" if part.rests_on else ""
        yield "part", f"{part.file}{f' in {part.unit}' if part.unit else ''}{scale}{standing}"
        yield "bodies", ", ".join(body.name for body in cell.bodies()) or "none"
        yield "seed", str(cell.planner.seed)


def place_words(position_m: Any) -> str:
    """Write a position (3,) in m as people do."""
    return "({}) mm".format(", ".join(f"{1e3 * value:.4g}" for value in position_m))
