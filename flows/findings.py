"""Why there is no plan: what stands in the way of each sample, counted, drawn on the part and written down.

A run that finds no plan is an answer, and its evidence lies in the lake: which candidates see a sample and what
stopped each of them. Here it becomes a table on the terminal, a short page, a picture and JSON.
"""

from __future__ import annotations

import base64
import contextlib
import json
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tasks
from cellwright.causes import Cause
from cellwright.errors import CellwrightError, InvalidInputError, UnsafePlanError
from flows.result_folder import write_files
from schemas.references import Ref
from tasks.explain_samples import ExplanationParams
from tasks.write_report import CAUSE_WORDS

if TYPE_CHECKING:
    from rich.console import Console

    from flows.requests import InspectionRequest
    from flows.runner import Step, Steps
    from storage.lake import Lake

_WORDS = {
    **CAUSE_WORDS,
    Cause.NOT_SELECTED: "nothing: a sweep that the robot can execute would measure it",
    Cause.NOT_SCANNED: "nothing: a selected sweep would measure it, but the plan ended before it was scanned",
}

_STOPPED = {
    "read_source": "A file cannot be read.",
    "assemble_cell": "The cell cannot be used as the cell file describes it.",
    "preprocess_mesh": "The part's mesh cannot be used.",
    "select_views": "No choice of sweeps measures as much of the part as is asked for.",
    "stitch_sweeps": "The chosen sweeps cannot be joined to one motion.",
    "verify_plan": "A plan was found, but it fails its independent verification and must not be run.",
}
"""What a run was stopped by, by the stage that failed."""

_OF_A_PLAN = ("report.html", "plan.mcap", "trajectory.parquet", "segments.parquet", "scan.parquet")
FILES = ("findings.html", "findings.json", "findings.png", "findings_cell.png")


@dataclass(frozen=True)
class Findings:
    """What is known about a run that ended without a plan.

    Attributes:
        name: The cell's name.
        run_id: The run, as the lake has recorded it.
        step: The step that failed; empty if none did.
        error: The message.
        exit_code: Its exit code.
        n_samples: Planning samples that were asked about; 0 if the run did not come so far.
        causes: Samples by what stopped them.
        collides_with: Samples that a collision stopped, by the body that stopped the most of their candidates.
        overlaps: Bodies that stand in one another, and that the part would tip, in words.
        ref: The artefact that says it sample by sample.
        picture: The part, coloured by cause, as PNG bytes; empty if there is none.
        cell_picture: The whole cell as PNG bytes; empty if it could not be built.
        failed_motion: Where a finished plan fails its verification, in words; the picture of the cell shows it.
        earlier: Files of an earlier plan that stand in the folder still.
        files: Exported files by what they are.
    """

    name: str
    run_id: str
    step: str
    error: str
    exit_code: int
    n_samples: int = 0
    causes: dict[str, int] = field(default_factory=dict)
    collides_with: dict[str, int] = field(default_factory=dict)
    overlaps: tuple[str, ...] = ()
    ref: Ref | None = None
    picture: bytes = b""
    cell_picture: bytes = b""
    failed_motion: str = ""
    earlier: tuple[str, ...] = ()
    files: dict[str, Path] = field(default_factory=dict)

    @property
    def stage(self) -> str:
        """The stage that failed."""
        return self.step.partition(" ")[0]

    def as_json(self) -> Mapping[str, Any]:
        """Return the findings as plain values."""
        return {
            "name": self.name,
            "run_id": self.run_id,
            "step": self.step,
            "error": self.error,
            "exit_code": self.exit_code,
            "samples": self.n_samples,
            "causes": self.causes,
            "collides_with": self.collides_with,
            "overlaps": list(self.overlaps),
            "failed_motion": self.failed_motion,
            "artefact": None if self.ref is None else {"kind": self.ref.kind, "digest": self.ref.digest},
            "earlier_files": list(self.earlier),
            "files": {name: str(path) for name, path in self.files.items()},
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return a row a cause, the most samples first: label, samples, share, words, colour."""
        from cellwright.figures.coverage_map import CAUSE_COLOURS

        bodies = ", ".join(f"{body} ({count:,})" for body, count in self.collides_with.items())
        return [
            {
                "cause": label,
                "samples": count,
                "share": count / self.n_samples,
                "words": _WORDS[_named(label)] + (f" with {bodies}" if bodies and label == "collision" else ""),
                "colour": CAUSE_COLOURS[_named(label)],
            }
            for label, count in self.causes.items()
        ]

    def show(self, console: Console) -> None:
        """Print the causes and the paths."""
        from rich.table import Table

        if self.n_samples:
            table = Table(title=f"No plan for {self.name}: {self.n_samples:,} samples", title_justify="left")
            for column, justify in (("samples", "right"), ("share", "right"), ("cause", "left"), ("", "left")):
                table.add_column(column, justify=justify)  # type: ignore[arg-type]  # rich takes these words
            for row in self.rows():
                table.add_row(f"{row['samples']:,}", f"{row['share']:.1%}", row["cause"], row["words"])
            console.print(table)
        for overlap in self.overlaps:
            console.print(f"Attention: {overlap}.", soft_wrap=True, markup=False)
        if self.failed_motion:
            console.print(self.failed_motion, soft_wrap=True, markup=False)
        if self.ref is not None:
            console.print(f"sample by sample: cellwright lake show {self.ref}", soft_wrap=True)
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True)
        if self.earlier:
            console.print(f"Of an earlier run, not of this one: {', '.join(self.earlier)}.", soft_wrap=True)

    def as_markdown(self) -> str:
        """Return the findings for Prefect's user interface."""
        rows = "\n".join(f"| {row['cause']} | {row['samples']} | {row['words']} |" for row in self.rows())
        table = f"\n\n| cause | samples | what stops them |\n|---|---:|---|\n{rows}\n" if rows else "\n"
        overlaps = "".join(f"\n\n{overlap}" for overlap in self.overlaps)
        motion = self.failed_motion and f"\n\n{self.failed_motion}"
        return f"# No plan for {self.name}\n\n{self.error}{motion}{overlaps}{table}"


def find_causes(step: Steps, request: InspectionRequest, lake: Lake, run_id: str, error: CellwrightError) -> Findings:
    """Ask the artefacts of a run that failed why it did; a second's work, and an artefact of its own.

    Where the run did not come as far as the arm, the error is all there is. What goes wrong on the way is noted on the
    error and hides nothing.
    """
    done = {record.name for record in step.done()}
    known = Findings(request.name, run_id, step.failed(error), str(error), error.exit_code)
    with noting(error, "drawing the cell"):
        known = _drawn_motion(known, step, request, lake, error)
        if not known.cell_picture:
            known = replace(known, cell_picture=_drawn_cell(request, done, known.stage))
    if "find_overlaps" in done:
        with noting(error, "looking for overlaps"):
            overlaps: Any = lake.load(_step(step, "find_overlaps").ref())
            known = replace(known, overlaps=overlaps.attention)
    if isinstance(error, UnsafePlanError):
        return known  # samples have nothing in their way but the motion
    names = {
        "mesh": "preprocess_mesh",
        "surroundings": "place_surroundings",
        "samples": "sample_surface planning",
        "viewpoints": "sample_viewpoints",
        "reachability": "follow_sweeps",
    }
    if not done.issuperset(names.values()):
        return known
    with noting(error, "explaining it"):
        inputs = {what: _step(step, name) for what, name in names.items()}
        selected = [record.name for record in step.done() if record.stage == "select_views"]
        selection = _step(step, selected[-1]) if selected else None
        params = ExplanationParams(**request.sensing.model_dump())
        ref = step(tasks.explain_samples, params, label="", **inputs, selection=selection).ref()
        known = _counted(known, lake, ref, inputs["mesh"].ref(), inputs["samples"].ref())
    return known


@contextlib.contextmanager
def noting(error: CellwrightError, doing: str) -> Iterator[None]:
    """Write what fails inside down as a note of ``error``, which is what the person must see."""
    try:
        yield
    except Exception as failure:  # noqa: BLE001  # bugs too: none of them is worth more than the error it would hide
        said = str(failure) if isinstance(failure, CellwrightError) else f"{type(failure).__name__}: {failure}"
        error.add_note(f"{doing} failed: {said}")


def _step(step: Steps, name: str) -> Step:
    found = step.named(name)
    if found is None:
        raise RuntimeError(f"step {name} is done but was never started")
    return found


def _drawn_cell(request: InspectionRequest, done: Set[str], failed: str) -> bytes:
    """Return a picture of the cell, also where it was refused because bodies collide at the start; else nothing."""
    from flows.cell_picture import picture_of

    if "assemble_cell" not in done and failed != "assemble_cell":
        return b""
    with contextlib.suppress(InvalidInputError):  # what cannot be built cannot be seen, and is told already
        return picture_of(request)
    return b""


def _drawn_motion(
    known: Findings, step: Steps, request: InspectionRequest, lake: Lake, error: CellwrightError
) -> Findings:
    from flows.failed_motion import failed_motion
    from schemas.motion import Trajectory

    planned = step.handed_to_failed(error, Trajectory)
    if not isinstance(error, UnsafePlanError) or planned is None:
        return known
    trajectory: Any = lake.load(planned.ref())
    found = failed_motion(error, _as_planned(step, request, lake, error), trajectory)
    return known if found is None else replace(known, failed_motion=found.where, cell_picture=found.picture)


def _as_planned(step: Steps, request: InspectionRequest, lake: Lake, error: CellwrightError) -> InspectionRequest:
    """Return the request with everything standing where the plan that failed has it."""
    from flows.placement_rounds import MOVED
    from schemas.sources import CellModel

    cell, placement = step.handed_to_failed(error, CellModel), step.named("optimise_placement")
    if cell is None or placement is None or not cell.name.endswith(MOVED):
        return request
    found: Any = lake.load(placement.ref())
    return request.moved(found)


def _counted(known: Findings, lake: Lake, ref: Ref, mesh_ref: Ref, samples_ref: Ref) -> Findings:
    import numpy as np

    from cellwright.figures.coverage_map import coverage_picture

    found: Any = lake.load(ref)
    mesh: Any = lake.load(mesh_ref)
    samples: Any = lake.load(samples_ref)
    picture = coverage_picture(
        mesh.vertices_m,
        mesh.faces,
        mesh.to_measure,
        samples.points_m,
        samples.normals,
        found.cause,
        spacing=1.0 / float(np.sqrt(max(samples.density_per_m2, 1e-9))),
        two_sided=mesh.two_sided,
    )
    counts = np.bincount(found.cause, minlength=len(Cause))
    bodies = np.bincount(found.blocked_by[found.blocked_by >= 0], minlength=len(found.body))
    return replace(
        known,
        n_samples=len(found.cause),
        causes=_falling({cause.label: int(counts[cause]) for cause in Cause}),
        collides_with=_falling({name: int(count) for name, count in zip(found.body, bodies)}),
        ref=ref,
        picture=picture,
    )


def export(findings: Findings, folder: Path) -> Findings:
    """Write page, picture and JSON into a folder; return the findings with the paths.

    Raises:
        InvalidInputError: If the folder cannot be written.
    """
    import jinja2

    named = {"findings": folder / FILES[0], "findings as JSON": folder / FILES[1]}
    if findings.picture:
        named["figure: findings"] = folder / FILES[2]
    if findings.cell_picture:
        named["figure: cell"] = folder / FILES[3]
    earlier = tuple(name for name in _OF_A_PLAN if (folder / name).exists())
    found = replace(findings, files=named, earlier=earlier)
    template = resources.files("flows").joinpath("templates/findings.html.j2").read_text("utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    message, keys = _message_and_keys(found.error)
    page = environment.from_string(template).render(
        findings=found,
        stopped=_STOPPED.get(found.stage, "The run ended without a plan."),
        message=message,
        keys=keys,
        rows=found.rows(),
        picture=base64.b64encode(found.picture).decode(),
        cell_picture=base64.b64encode(found.cell_picture).decode(),
    )
    contents = {
        FILES[0]: page.encode(),
        FILES[1]: json.dumps(found.as_json(), indent=2, sort_keys=True, ensure_ascii=False).encode() + b"\n",
        **({FILES[2]: found.picture} if found.picture else {}),
        **({FILES[3]: found.cell_picture} if found.cell_picture else {}),
    }
    write_files(folder, contents, mark=FILES[1], gone=FILES)
    return found


def _message_and_keys(error: str) -> tuple[str, str]:
    """Part a message from the keys of the cell file that `cell_keys` writes behind it."""
    message, begins, keys = error.rpartition(" (in ")
    return (message, keys.removesuffix(")")) if begins and error.endswith(")") else (error, "")


def _falling(counts: dict[str, int]) -> dict[str, int]:
    """Return what was counted at all, the most first, equal counts by name."""
    return dict(sorted(((name, n) for name, n in counts.items() if n), key=lambda item: (-item[1], item[0])))


def _named(label: str) -> Cause:
    return next(cause for cause in Cause if cause.label == label)
