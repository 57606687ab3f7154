"""The flow `layout`: from a layout file to the places of all stations, the robot's cycle, and their report.

`plan_layout` chains the stages and says nothing else; `run` is what command line, studies and tests call. A layout
that misses its gate is an error; a study may ask for the attempt instead (``attempt=True``).
"""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import tasks
from cellwright.errors import InfeasibleError, InvalidInputError
from flows.caches import use_own_caches
from flows.execution import Watcher, open_lake
from flows.layout_requests import LayoutRequest, layout_request
from flows.layout_result import LayoutResult
from flows.result_folder import prepared, write_files
from flows.run_result import RUN_MARK, computing_seconds, gathered
from flows.runner import Step, Steps, watched
from schemas.layout_file import LayoutFile, load_layout_file
from schemas.layout_summary import refusal_of, summary_of
from storage.lake import Lake


def run(
    layout_file: Path | LayoutFile,
    *,
    overrides: Sequence[str] = (),
    lake: str,
    refresh: Collection[str] = frozenset(),
    out: Path | None = None,
    watcher: Watcher | None = None,
    direct: bool = False,
    attempt: bool = False,
) -> LayoutResult:
    """Optimise, record and report the layout that a file describes.

    Args:
        layout_file: The layout file, or what was loaded from it.
        overrides: Settings ``path=value`` laid over it, unless it is loaded.
        lake: Folder or address of the lake.
        refresh: Stages to compute although the lake has them.
        out: Folder for report, recording and figures; nothing is exported if left out.
        watcher: Hears of the stages while they run.
        direct: Run without Prefect, one stage after the other.
        attempt: Stop after the optimisation, and hand back what missed its gate too.

    Raises:
        InvalidInputError: If the file, a mesh or the robot are malformed, the layout overlaps where it is placed, or
            the folder cannot be written.
        InfeasibleError: If no start passed its gate: which constraint blocks, and the smallest relaxation.
        LakeError: If the lake fails.
    """
    use_own_caches()
    file = load_layout_file(layout_file, overrides) if isinstance(layout_file, Path) else layout_file
    with prepared(out), _naming(file.path), watched(watcher):
        request = layout_request(file)
        if direct:
            result = optimise_and_report(request, lake, refresh, uuid.uuid4().hex, direct=True, attempt=attempt)
        else:
            from flows.layout_flow import layout

            result = layout(request, lake, sorted(refresh), attempt)
    if out is not None and not attempt:
        result.files.update(export(open_lake(lake), result, out))
    return result


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the layout file in what is wrong with it: stages know its content only."""
    try:
        yield
    except (InvalidInputError, InfeasibleError) as error:
        if str(path) in str(error):
            raise
        told = type(error)(f"{path}: {error}")
        vars(told).update(vars(error))  # its notes
        raise told from error


def optimise_and_report(
    request: LayoutRequest, lake_url: str, refresh: Collection[str], run_id: str, *, direct: bool, attempt: bool
) -> LayoutResult:
    """Run the chain, write down what the run used, and gather its figures."""
    lake = open_lake(lake_url)
    facts = {"flow": "layout", "cell": request.name}
    with Steps(lake_url, refresh=refresh, direct=direct, run_id=run_id, facts=facts) as step:
        steps = plan_layout(step, request, lake, attempt=attempt)
        result = _result(request, lake, run_id, steps, step)
    return replace(result, notes=tuple(step.notes))


def plan_layout(step: Steps, request: LayoutRequest, lake: Lake, *, attempt: bool = False) -> dict[str, Step]:
    """Chain the stages of a layout; returns the steps by the name of what they make.

    Raises:
        InfeasibleError: If no start passed its gate, unless an ``attempt`` is asked for.
    """
    for note in request.notes:
        step.note(note)
    urdf = None if request.urdf is None else step(tasks.read_source, request.urdf, label=request.urdf.name)
    meshes = tuple(step(tasks.read_source, source, label=source.name) for source in request.robot_files)
    bodies = tuple(step(tasks.read_source, source, label=source.name) for source in request.body_files)
    of_robot = meshes if urdf is None else (urdf, *meshes)
    robot = None if request.robot_hull is None else step(tasks.spherize_robot, request.robot_hull, files=of_robot)
    hulls = None if request.cover is None else step(tasks.cover_bodies, request.cover, files=bodies)
    given: dict[str, Any] = {"urdf": urdf, "robot": robot, "hulls": hulls}
    layout = step(tasks.optimise_layout, request.layout, **given)
    steps = {"urdf": urdf, "robot": robot, "hulls": hulls, "layout": layout}
    made = {name: each for name, each in steps.items() if each is not None}
    if attempt:
        return made
    found: Any = lake.load(layout.ref())
    if not found.converged:
        raise InfeasibleError(refusal_of(found, sought=request.layout.extras))
    recording = step(tasks.record_layout, request.recording, files=(*meshes, *bodies), layout=layout, **given)
    report = step(tasks.write_layout_report, request.report, layout=layout, **given)
    return {**made, "recording": recording, "report": report}


def _result(request: LayoutRequest, lake: Lake, run_id: str, steps: dict[str, Step], step: Steps) -> LayoutResult:
    layout: Any = lake.load(steps["layout"].ref())
    report: Any = lake.load(steps["report"].ref()) if "report" in steps else None
    facts = gathered(request.name, run_id, lake, steps, step.records())
    optimised = next(record for record in facts["records"] if record.stage == "optimise_layout")
    _, cpu_s = computing_seconds(lake, optimised)
    return LayoutResult(**facts, cpu_s=cpu_s, summary=summary_of(layout), report=report)


def export(lake: Lake, result: LayoutResult, folder: Path) -> dict[str, Path]:
    """Write a layout's files and return their paths by what they are.

    Raises:
        InvalidInputError: If the folder cannot be written.
        LakeError: If the lake has lost a file since the run.
    """
    page = "" if result.report is None else result.report.page.decode().replace(RUN_MARK, _run_section(result))
    contents = {
        "report": ("report.html", page.encode()),
        "recording (Foxglove, Rerun)": ("layout.mcap", lake.read(result.refs["recording"], "recording.mcap")),
        "layout": ("layout.parquet", lake.read(result.refs["layout"], "design.parquet")),
        "motion": ("motion.parquet", lake.read(result.refs["layout"], "states.parquet")),
        "starts": ("starts.parquet", lake.read(result.refs["layout"], "starts.parquet")),
        "summary": ("summary.json", result.summary_file()),
        **{f"figure: {name}": (f"{name}.png", picture) for name, picture in result.pictures().items()},
    }
    write_files(folder, dict(contents.values()), mark=contents["summary"][0])
    return {what: folder / name for what, (name, _) in contents.items()}


def _run_section(result: LayoutResult) -> str:
    cpu = "" if result.cpu_s is None else f" The optimisation took {result.cpu_s:.2f} s of processor time."
    return result.stages_section(cpu) + result.run_line
