"""`cellwright spherize MESH --curve`: how well a hull fits as a function of the number of its spheres.

Every number is one stage of its own, so numbers that are asked for again come from the lake. The pictures are those of
Baumgaertner 2025, figure 3: the body under its hulls, and the metrics over the number of spheres.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellwright.errors import InvalidInputError
from flows.execution import Watcher, open_lake
from flows.result_folder import prepare_folder, write_files
from flows.runner import Steps
from flows.spherize import cover_mesh, is_robot, unit_factor
from schemas.sphere_hull import SphereHull

if TYPE_CHECKING:
    from rich.console import Console

MOST_PANELS = 5
"""Hulls that are drawn side by side."""
_LENGTHS = ("protrusion_mean", "protrusion_p95", "protrusion_max", "gap_mean", "gap_p95", "gap_max", "overshoot_max")


@dataclass(frozen=True)
class CurveResult:
    """The metrics of one mesh's hulls.

    Attributes:
        name: What was covered.
        rows: One mapping a hull, by rising number of spheres; lengths in m.
        files: Written files by what they are.
    """

    name: str
    rows: list[dict[str, Any]]
    files: dict[str, Path] = field(default_factory=dict)

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""
        return {"name": self.name, "hulls": self.rows, "files": {name: str(path) for name, path in self.files.items()}}

    def show(self, console: Console) -> None:
        """Print the table of metrics and the paths."""
        from rich.table import Table

        table = Table(title=f"Spheres of {self.name}", title_justify="left")
        names = ("spheres", "proven", "covered", "volume ratio", "sticks out, mm (mean)", "(95 %)", "(largest)")
        for name in (*names, "(bound)", "gap, mm (largest)"):
            table.add_column(name, justify="right")
        for row in self.rows:
            keys = ("protrusion_mean_m", "protrusion_p95_m", "protrusion_max_m", "overshoot_max_m", "gap_max_m")
            proven = "yes" if row["surface_covered"] else "no"
            first = (str(row["n_spheres"]), proven, f"{row['coverage']:.2%}", f"{row['volume_ratio']:.2f}")
            table.add_row(*first, *(f"{1e3 * row[key]:.1f}" for key in keys))
        console.print(table)
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True)


def run(
    subject: str,
    numbers: Sequence[int],
    *,
    unit: str | None,
    seed: int,
    lake: str,
    refresh: Collection[str],
    out: Path | None,
    watcher: Watcher,
) -> CurveResult:
    """Cover a mesh file with each of several numbers of spheres.

    Args:
        subject: The mesh file.
        numbers: Numbers of spheres.
        unit: Unit of a mesh that carries none; mm if left out.
        seed: Seed of all random choices.
        lake: Folder or address of the lake.
        refresh: Stages to compute although the lake has them.
        out: JSON to write, with the two pictures beside it.
        watcher: Hears of the stages while they run.

    Raises:
        InvalidInputError: If the mesh is malformed, missing, or a robot, or the files cannot be written.
        SolverError: If a proof fails.
        LakeError: If the lake fails.
    """
    if is_robot(subject):
        raise InvalidInputError(
            f"--curve measures one mesh, and {subject} is a robot: name the mesh of one of its links"
        )
    if out is not None:
        if out.suffix.lower() != ".json":
            raise InvalidInputError(f"--out {out} is of another kind: name a .json file")
        prepare_folder(out.parent)
    facts = {"flow": "spherize", "cell": subject}
    with Steps(lake, refresh=refresh, watcher=watcher, direct=True, run_id=uuid.uuid4().hex, facts=facts) as step:
        made = [cover_mesh(step, subject, n, unit, seed, label=f"{n} spheres") for n in sorted(set(numbers))]
        refs = [each.ref() for each in made]
    opened = open_lake(lake)
    hulls: list[Any] = [opened.load(ref) for ref in refs]
    result = CurveResult(Path(subject).name, [_row(hull) for hull in hulls])
    if out is not None:
        contents = _files(subject, hulls, result.rows, unit, out)
        write_files(out.parent, dict(contents.values()), mark=out.name)
        result.files.update({what: out.parent / file for what, (file, _) in contents.items()})
    return result


def _row(hull: SphereHull) -> dict[str, Any]:
    return {
        "n_spheres": int(hull.n_spheres[0]),
        "surface_covered": bool(hull.surface_covered[0]),
        "interior": hull.interior[0],
        "coverage": float(hull.coverage[0]),
        "volume_ratio": float(hull.volume_ratio[0]),
        **{f"{name}_m": float(getattr(hull, f"{name}_m")[0]) for name in _LENGTHS},
    }


def _files(
    subject: str, hulls: Sequence[SphereHull], rows: list[dict[str, Any]], unit: str | None, out: Path
) -> dict[str, tuple[str, bytes]]:
    from cellwright.cell.mesh_files import mesh_from_bytes
    from cellwright.figures.sphere_hull_picture import hull_picture, metrics_chart

    path = Path(subject)
    mesh = mesh_from_bytes(path.name, path.read_bytes(), np.full(3, unit_factor(subject, unit)))
    # the first and the last, and evenly between them
    shown = sorted({round(at) for at in np.linspace(0, len(hulls) - 1, min(MOST_PANELS, len(hulls)))})
    panels = [(f"{len(hulls[row].radius_m)} spheres", hulls[row].centre_m, hulls[row].radius_m) for row in shown]
    plain = [{"line": "certified", **{key.removesuffix("_m"): value for key, value in row.items()}} for row in rows]
    return {
        "picture": (f"{out.stem}.png", hull_picture(mesh.vertices, mesh.faces, panels)),
        "metrics over the number of spheres": (f"{out.stem}_metrics.png", metrics_chart(plain)),
        "metrics": (out.name, json.dumps({"mesh": path.name, "hulls": rows}, indent=1).encode() + b"\n"),
    }
