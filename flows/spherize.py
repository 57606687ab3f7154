"""`cellwright spherize`: a robot or a mesh in, few spheres that are proven to hold it out.

One stage and no chain, so Prefect has no part in it; the stage's artefact comes from the lake if it is there.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import tasks
from cellwright.cell.built_in_robots import BUILT_IN, built_in_digest
from cellwright.errors import InvalidInputError
from flows.execution import Watcher, open_lake
from flows.mesh_sources import all_robot_meshes, carries_unit, metres_per_unit
from flows.result_folder import prepare_folder, write_files
from flows.runner import Steps
from schemas.body_params import MeshBody
from schemas.cell_file_fields import MESH_SUFFIXES
from schemas.cell_file_messages import did_you_mean
from schemas.layout import RobotHull
from schemas.references import Ref
from schemas.sphere_hull import SphereHull
from schemas.sphere_hull_columns import LENGTHS
from tasks.cover_bodies import CoveredBody, CoverParams
from tasks.read_source import SourceParams
from tasks.spherize_robot import RobotHullParams

if TYPE_CHECKING:
    from rich.console import Console

ROBOT_SUFFIXES = (".urdf", ".xml")


@dataclass(frozen=True)
class SpherizeResult:
    """Hulls and how well they fit.

    Attributes:
        name: What was covered.
        ref: The artefact.
        rows: One mapping a body: name, number of spheres, proofs and metrics, lengths in m.
        cached: Whether the lake had it.
        files: Written files by what they are.
    """

    name: str
    ref: Ref
    rows: list[dict[str, Any]]
    cached: bool
    files: dict[str, Path] = field(default_factory=dict)

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""
        files = {name: str(path) for name, path in self.files.items()}
        artefact = {"kind": self.ref.kind, "digest": self.ref.digest}
        return {"name": self.name, "artefact": artefact, "bodies": self.rows, "files": files}

    def show(self, console: Console) -> None:
        """Print the table of metrics and the paths."""
        from rich.table import Table

        table = Table(title=f"Spheres of {self.name}", title_justify="left")
        table.add_column("body")
        for name in ("spheres", "proven", "volume ratio", "sticks out, mm (mean)", "(largest)", "(bound)"):
            table.add_column(name, justify="right")
        for row in self.rows:
            lengths = [f"{1e3 * row[key]:.1f}" for key in ("protrusion_mean_m", "protrusion_max_m", "overshoot_m")]
            proven = "yes" if row["surface_covered"] else "no"
            table.add_row(row["body"], str(row["n_spheres"]), proven, f"{row['volume_ratio']:.2f}", *lengths)
        console.print(table)
        console.print("From the lake." if self.cached else "Computed now.")
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True)


def run(
    subject: str,
    *,
    n_spheres: int,
    unit: str | None,
    seed: int,
    packages: Mapping[str, Path],
    lake: str,
    refresh: Collection[str],
    out: Path | None,
    watcher: Watcher,
) -> SpherizeResult:
    """Cover a robot (URDF file or built-in name) or a mesh file with spheres.

    Args:
        subject: What to cover.
        n_spheres: Spheres of the mesh, or of a link on average.
        unit: Unit of a mesh that carries none; mm if left out.
        seed: Seed of all random choices.
        packages: Folders of the packages that a URDF names.
        lake: Folder or address of the lake.
        refresh: Stages to compute although the lake has them.
        out: Spherized URDF (with its SRDF) or JSON to write, and a picture beside it.
        watcher: Hears of the stages while they run.

    Raises:
        InvalidInputError: If the subject is malformed or missing, or the files cannot be written.
        SolverError: If a proof fails.
        LakeError: If the lake fails.
    """
    covers_robot = is_robot(subject)
    if out is not None:
        wanted = ROBOT_SUFFIXES if covers_robot else (".json",)
        if out.suffix.lower() not in wanted:
            raise InvalidInputError(f"--out {out} is of another kind: name a {' or '.join(wanted)} file")
        prepare_folder(out.parent)
    facts = {"flow": "spherize", "cell": subject}
    run_id = uuid.uuid4().hex
    with Steps(lake, refresh=refresh, watcher=watcher, direct=True, run_id=run_id, facts=facts) as step:
        if covers_robot:
            made = _robot(step, subject, n_spheres, seed, packages)
        else:
            made = cover_mesh(step, subject, n_spheres, unit, seed)
        ref = made.ref()
        cached = step.records()[-1].cached
    found: Any = open_lake(lake).load(ref)
    name = subject if covers_robot and subject in _built_in() else Path(subject).name
    result = SpherizeResult(name, ref, _robot_rows(found) if covers_robot else mesh_rows(found), cached)
    if out is not None:
        contents = (
            _robot_files(subject, found, packages, out) if covers_robot else _mesh_files(subject, found, unit, out)
        )
        write_files(out.parent, dict(contents.values()), mark=out.name)
        result.files.update({what: out.parent / file for what, (file, _) in contents.items()})
    return result


def _built_in() -> list[str]:
    return [robot.name for robot in BUILT_IN]


def is_robot(subject: str) -> bool:
    """Tell robots from meshes.

    Raises:
        InvalidInputError: If it is neither.
    """
    path = Path(subject)
    suffix = path.suffix.lower()
    if subject in _built_in() or suffix in ROBOT_SUFFIXES:
        return True
    if suffix in MESH_SUFFIXES:
        return False
    if not suffix and not path.exists():
        raise InvalidInputError(f"{subject!r} is no file and no built-in robot: {did_you_mean(subject, _built_in())}")
    kinds = ", ".join((*ROBOT_SUFFIXES, *MESH_SUFFIXES))
    raise InvalidInputError(f"{subject} is of no known kind: use one of {kinds}, or the name of a built-in robot")


def _robot(step: Steps, subject: str, n_spheres: int, seed: int, packages: Mapping[str, Path]) -> Any:
    if subject in _built_in():
        params = RobotHullParams(robot=subject, robot_sha256=built_in_digest(subject), n_spheres=n_spheres, seed=seed)
        return step(tasks.spherize_robot, params, files=())
    urdf = Path(subject)
    meshes = all_robot_meshes(urdf, packages, "or name its package by --package NAME=FOLDER")
    files = tuple(step(tasks.read_source, source, label=source.name) for source in (SourceParams.of(urdf), *meshes))
    params = RobotHullParams(robot=urdf.name, n_spheres=n_spheres, seed=seed)
    return step(tasks.spherize_robot, params, files=files)


def cover_mesh(
    step: Steps, subject: str, n_spheres: int, unit: str | None, seed: int, *, label: str = "", **fit: Any
) -> Any:
    """Return the step that covers a mesh file with spheres; ``fit`` holds further fields of `CoverParams`.

    Raises:
        InvalidInputError: If a mesh that carries its own unit is given another.
    """
    source = SourceParams.of(Path(subject))
    factor = unit_factor(subject, unit)
    body = MeshBody(name=Path(subject).stem, file=source.name, scale=(factor, factor, factor))
    params = CoverParams(bodies=(CoveredBody(body=body, n_spheres=n_spheres),), seed=seed, **fit)
    return step(tasks.cover_bodies, params, label=label, files=(step(tasks.read_source, source, label="mesh"),))


def unit_factor(subject: str, unit: str | None) -> float:
    """Return the metres of one unit of a mesh file.

    Raises:
        InvalidInputError: If a mesh that carries its own unit is given another.
    """
    if carries_unit(Path(subject)) and unit is not None:
        raise InvalidInputError(f"{Path(subject).name} carries its own unit: leave --unit out")
    return metres_per_unit(Path(subject), unit)


def _robot_rows(hull: RobotHull) -> list[dict[str, Any]]:
    return [
        {
            "body": link,
            "n_spheres": int(hull.n_spheres[row]),
            "surface_covered": bool(hull.surface_covered[row]),
            "interior": hull.interior[row],
            **_metrics(hull, row),
            "overshoot_m": float(hull.overshoot_m[row]),
        }
        for row, link in enumerate(hull.link)
    ]


def mesh_rows(hull: SphereHull) -> list[dict[str, Any]]:
    """Return a mapping for each body: proofs and metrics of its hull, lengths in m."""
    return [
        {
            "body": name,
            "n_spheres": int(hull.n_spheres[row]),
            "surface_covered": bool(hull.surface_covered[row]),
            "interior": hull.interior[row],
            **_metrics(hull, row),
            "overshoot_m": float(hull.overshoot_max_m[row]),
        }
        for row, name in enumerate(hull.body)
    ]


def _metrics(hull: RobotHull | SphereHull, row: int) -> dict[str, Any]:
    columns = ("coverage", "volume_ratio", *(f"{name}_m" for name in LENGTHS))
    return {name: float(getattr(hull, name)[row]) for name in columns} | {"volume_kind": hull.volume_kind[row]}


def _robot_files(
    subject: str, hull: RobotHull, packages: Mapping[str, Path], out: Path
) -> dict[str, tuple[str, bytes]]:
    from cellwright.cell.built_in_robots import built_in_meshes, built_in_urdf
    from cellwright.cell.urdf_geometry import meshes_in

    if subject in _built_in():
        text, read = built_in_urdf(subject), built_in_meshes(subject)
    else:
        text, read = Path(subject).read_text("utf-8"), meshes_in(Path(subject).parent, packages)
    metrics = {"robot": hull.name, "links": _robot_rows(hull), "touching": _touching(hull)}
    picture = _robot_picture(text, read, hull)
    return {
        "metrics": (f"{out.stem}.json", json.dumps(metrics, indent=1).encode() + b"\n"),
        "pairs to ignore": (f"{out.stem}.srdf", hull.srdf),
        "picture": (f"{out.stem}.png", picture),
        "spherized URDF": (out.name, hull.urdf),
    }


def _touching(hull: RobotHull) -> list[dict[str, Any]]:
    """Return how often hulls that are to be checked touch in random configurations."""
    return [
        {"links": [hull.link[one], hull.link[other]], "share": float(share)}
        for (one, other), share in zip(hull.checked_pair.tolist(), hull.touching_share)
        if share > 0.0
    ]


def _robot_picture(text: str, read_mesh: Any, hull: RobotHull) -> bytes:
    from cellwright.cell.spherized_urdf import link_shapes, merged_mesh
    from cellwright.cell.transforms import apply
    from cellwright.cell.urdf_tree import parse_urdf
    from cellwright.figures.sphere_hull_picture import hull_picture

    tree = parse_urdf(text)
    rest = tree.rest_poses()
    meshes = {link: merged_mesh(shapes) for link, shapes in link_shapes(tree, read_mesh).items()}
    vertices = [apply(rest[link], mesh.vertices) for link, mesh in meshes.items()]
    offsets = np.cumsum([0, *(len(each) for each in vertices)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes.values(), offsets.tolist())]
    centres = [
        apply(rest[link], hull.centre_m[hull.first_sphere[row] : hull.first_sphere[row] + hull.n_spheres[row]])
        for row, link in enumerate(hull.link)
    ]
    spheres = (f"{len(hull.radius_m)} spheres", np.concatenate(centres), hull.radius_m)
    return hull_picture(np.concatenate(vertices), np.concatenate(faces).astype(np.int32), [spheres])


def _mesh_files(subject: str, hull: SphereHull, unit: str | None, out: Path) -> dict[str, tuple[str, bytes]]:
    from cellwright.cell.mesh_files import mesh_from_bytes
    from cellwright.figures.sphere_hull_picture import hull_picture

    path = Path(subject)
    mesh = mesh_from_bytes(path.name, path.read_bytes(), np.full(3, unit_factor(subject, unit)))
    spheres = [
        {"centre_m": centre, "radius_m": radius, "overshoot_m": overshoot}
        for centre, radius, overshoot in zip(hull.centre_m.tolist(), hull.radius_m.tolist(), hull.overshoot_m.tolist())
    ]
    plain = {**mesh_rows(hull)[0], "spheres": spheres}
    title = f"{len(hull.radius_m)} spheres"
    picture = hull_picture(mesh.vertices, mesh.faces, [(title, hull.centre_m, hull.radius_m)])
    return {
        "picture": (f"{out.stem}.png", picture),
        "spheres": (out.name, json.dumps(plain, indent=1).encode() + b"\n"),
    }
