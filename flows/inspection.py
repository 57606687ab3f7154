"""The flow `inspect`: from a part file and a cell to a verified scan trajectory and its report.

`plan_inspection` chains the stages and says nothing else; `run` is what command line, studies and tests call.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Collection, Sequence
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import Any

import tasks
from cellwright.cell.bodies import WORLD
from cellwright.cell.part import resting_pose, top_height
from cellwright.errors import CellwrightError, InfeasibleError, InvalidInputError, SolverError, listed
from flows import findings
from flows.caches import use_own_caches
from flows.cell_keys import with_keys
from flows.execution import Unwatched, Watcher, open_lake
from flows.findings import Findings
from flows.inspection_export import export
from flows.inspection_result import InspectionResult
from flows.requests import InspectionRequest, request_of
from flows.result_folder import prepare_folder
from flows.runner import Step, Steps
from schemas.cell_file import load_cell_file
from schemas.cell_objects import build_cell
from schemas.poses import Pose
from storage.lake import Lake
from tasks.stitch_sweeps import StitchParams

PLANNING_STAGES = frozenset(
    {
        "sample_surface",
        "sample_viewpoints",
        "measure_samples",
        "follow_sweeps",
        "trim_measurability",
        "select_views",
        "find_gaps",
        "extend_measurability",
        "stitch_sweeps",
    }
)
"""What the paper's planning time is made of: everything between the mesh and the finished trajectory."""


def is_planning(step_name: str) -> bool:
    """Whether a step counts as planning: the cloud on which the result is judged does not."""
    return step_name.split()[0] in PLANNING_STAGES and step_name != "sample_surface verification"


RESELECTIONS = 3
"""Times that views are selected again without those that could not be executed or connected."""

_WATCHER: ContextVar[Watcher | None] = ContextVar("inspection_watcher", default=None)
FINDINGS: ContextVar[list[Findings] | None] = ContextVar("inspection_findings", default=None)
"""Takes what a run without a plan has found out; like the watcher it stays in this process and never travels."""


def run(
    cell_file: Path,
    *,
    overrides: Sequence[str] = (),
    lake: str,
    refresh: Collection[str] = frozenset(),
    out: Path | None = None,
    watcher: Watcher | None = None,
    direct: bool = False,
    explain: Callable[[Findings], None] | None = None,
) -> InspectionResult:
    """Plan, verify and report the inspection that a cell file describes.

    Args:
        cell_file: The cell file.
        overrides: Settings ``path=value`` laid over it.
        lake: Folder or address of the lake.
        refresh: Stages to compute although the lake has them.
        out: Folder for report, recording and figures; nothing is exported if left out.
        watcher: Hears of the stages while they run.
        direct: Run without Prefect, one stage after the other.
        explain: Hears, before the error is raised, what stands in the way where there is no plan.

    Raises:
        InvalidInputError: If cell file, part or robot are malformed, or the folder cannot be written; before
            anything is computed where that can be known.
        InfeasibleError: If there is no plan, or the plan fails its verification.
        LakeError: If the lake fails.
    """
    use_own_caches()
    request = request_of(cell_file, overrides)
    if out is not None:
        prepare_folder(out)
    found: list[Findings] = []
    watching, finding = _WATCHER.set(watcher), FINDINGS.set(found)
    try:
        if direct:
            result = plan_and_record(request, lake, refresh, run_id=uuid.uuid4().hex, direct=True, found=found)
        else:
            from flows.inspection_flow import inspect

            result = inspect(request, lake, sorted(refresh))
    except CellwrightError as error:
        told = with_keys(error, load_cell_file(cell_file, overrides), found[0].stage if found else "")
        if found:
            _explain(replace(found[0], error=str(told)), out, explain)
        if told is error:
            raise
        raise told from error
    finally:
        FINDINGS.reset(finding)
        _WATCHER.reset(watching)
    if out is not None:
        result.files.update(export(open_lake(lake), result, out))
        findings.remove_earlier(out)
    return result


def _explain(found: Findings, out: Path | None, explain: Callable[[Findings], None] | None) -> None:
    if out is not None:
        found = findings.export(found, out)
    if explain is not None:
        explain(found)


def plan_and_record(
    request: InspectionRequest,
    lake_url: str,
    refresh: Collection[str],
    *,
    run_id: str,
    direct: bool,
    found: list[Findings],
) -> InspectionResult:
    """Run the chain, write down what the run used, and gather its figures; ``found`` takes why there is no plan."""
    lake = open_lake(lake_url)
    watcher = _WATCHER.get() or Unwatched()
    facts = {"flow": "inspect", "cell": request.name}
    with Steps(lake_url, refresh=refresh, watcher=watcher, direct=direct, run_id=run_id, facts=facts) as step:
        try:
            steps = plan_inspection(step, request, lake)
            return InspectionResult.of(request, lake, run_id, steps, step.records())
        except (InvalidInputError, InfeasibleError, SolverError) as error:
            found.append(findings.find_causes(step, request, lake, run_id, error))
            raise


def plan_inspection(step: Steps, request: InspectionRequest, lake: Lake) -> dict[str, Step]:
    """Chain the stages of an inspection; returns the steps by the name of what they make."""
    part = step(tasks.read_source, request.part, label="part")
    files = tuple(step(tasks.read_source, source, label=source.name) for source in request.cell_files)
    cell = step(tasks.assemble_cell, request.cell, files=files)
    mesh = step(tasks.preprocess_mesh, request.mesh, source=part)
    cloud = step(tasks.sample_surface, request.verification_cloud, label="verification", mesh=mesh)
    samples = step(tasks.sample_surface, request.samples, label="planning", mesh=mesh)
    viewpoints = step(tasks.sample_viewpoints, request.viewpoints, samples=samples)

    placed = {"T_world_part": part_pose(request, lake, mesh, cell)}
    surroundings = step(tasks.place_surroundings, request.surroundings.model_copy(update=placed), cell=cell)
    overlaps = step(tasks.find_overlaps, request.overlaps.model_copy(update=placed), cell=cell, mesh=mesh)
    seen = step(
        tasks.measure_samples,
        request.sensing,
        mesh=mesh,
        surroundings=surroundings,
        samples=samples,
        viewpoints=viewpoints,
    )
    reachability = step(
        tasks.follow_sweeps,
        request.sweeps.model_copy(update=placed),
        cell=cell,
        mesh=mesh,
        viewpoints=viewpoints,
        measurability=seen,
    )
    measurable = step(
        tasks.trim_measurability,
        request.trimming,
        samples=samples,
        viewpoints=viewpoints,
        measurability=seen,
        reachability=reachability,
    )
    selection = step(tasks.select_views, request.cover, measurability=measurable)
    selection, measurable = close_gaps(
        step, request, lake, mesh, surroundings, viewpoints, reachability, measurable, selection
    )
    stitching = request.stitching.model_copy(update=placed)
    selection, trajectory = connect_sweeps(
        step, request, stitching, lake, cell, mesh, viewpoints, reachability, measurable, selection
    )
    verification = step(
        tasks.verify_plan,
        request.verification.model_copy(update=placed),
        cell=cell,
        mesh=mesh,
        viewpoints=viewpoints,
        reachability=reachability,
        selection=selection,
        trajectory=trajectory,
    )
    scan = step(
        tasks.simulate_scan,
        request.scan.model_copy(update=placed),
        cell=cell,
        mesh=mesh,
        surroundings=surroundings,
        trajectory=trajectory,
    )
    coverage = step(
        tasks.measure_coverage,
        request.coverage,
        mesh=mesh,
        surroundings=surroundings,
        cloud=cloud,
        scan=scan,
        viewpoints=viewpoints,
        reachability=reachability,
        selection=selection,
        trajectory=trajectory,
    )
    recording = step(
        tasks.record_plan,
        request.recording.model_copy(update=placed),
        cell=cell,
        mesh=mesh,
        trajectory=trajectory,
        scan=scan,
    )
    report = step(
        tasks.write_report,
        request.report,
        mesh=mesh,
        cell=cell,
        cloud=cloud,
        overlaps=overlaps,
        coverage=coverage,
        viewpoints=viewpoints,
        reachability=reachability,
        selection=selection,
        trajectory=trajectory,
        verification=verification,
        scan=scan,
    )
    return {
        "cell": cell,
        "mesh": mesh,
        "overlaps": overlaps,
        "viewpoints": viewpoints,
        "reachability": reachability,
        "selection": selection,
        "trajectory": trajectory,
        "verification": verification,
        "scan": scan,
        "coverage": coverage,
        "recording": recording,
        "report": report,
    }


def close_gaps(
    step: Steps,
    request: InspectionRequest,
    lake: Lake,
    mesh: Step,
    surroundings: Step,
    viewpoints: Step,
    reachability: Step,
    measurable: Step,
    selection: Step,
) -> tuple[Step, Step]:
    """Add what the selection misses between the samples to what must be covered, and select again, for some rounds.

    Equally small selections differ in what they miss between the samples, so that a later round may miss more than an
    earlier one: the selection with the fewest gaps is returned, the earliest of several, with what it was made from.
    """
    if request.refinement_rounds == 0:
        return selection, measurable
    cloud = step(tasks.sample_surface, request.refinement_cloud, label="refinement", mesh=mesh)
    earlier: tuple[Step, ...] = ()
    best, fewest = (selection, measurable), None
    for number in range(1, request.refinement_rounds + 2):
        gaps = step(
            tasks.find_gaps,
            request.gaps,
            label=f"round {number}" if number <= request.refinement_rounds else "last",
            mesh=mesh,
            surroundings=surroundings,
            cloud=cloud,
            viewpoints=viewpoints,
            reachability=reachability,
            selection=selection,
            earlier=earlier,
        )
        found: Any = lake.load(gaps.ref())
        if fewest is None or len(found.point) < fewest:
            best, fewest = (selection, measurable), len(found.point)
        if fewest == 0 or number > request.refinement_rounds:
            break
        measurable = step(
            tasks.extend_measurability,
            request.extension,
            label=f"round {number}",
            mesh=mesh,
            surroundings=surroundings,
            cloud=cloud,
            gaps=gaps,
            viewpoints=viewpoints,
            measurability=measurable,
            reachability=reachability,
        )
        selection = step(tasks.select_views, request.cover, label=f"round {number}", measurability=measurable)
        earlier = (*earlier, gaps)
    return best


def connect_sweeps(
    step: Steps,
    request: InspectionRequest,
    stitching: StitchParams,
    lake: Lake,
    cell: Step,
    mesh: Step,
    viewpoints: Step,
    reachability: Step,
    measurable: Step,
    selection: Step,
) -> tuple[Step, Step]:
    """Stitch the selected sweeps; select again without those that had to be left out, for some rounds.

    Returns the selection and its trajectory. What the last one still leaves out is a finding; a plan without any sweep
    is an error.
    """
    earlier: Step | None = None
    n_left_out = 0
    for number in range(RESELECTIONS + 1):
        label = f"round {number + 1}" if number else ""
        if number:
            selection = step(
                tasks.select_views,
                request.cover,
                label=f"without unconnected, {label}",
                measurability=measurable,
                earlier=earlier,
            )
        trajectory = step(
            tasks.stitch_sweeps,
            stitching.model_copy(update={"min_sweeps": 1 if number == RESELECTIONS else 0}),
            label=label,
            cell=cell,
            mesh=mesh,
            viewpoints=viewpoints,
            reachability=reachability,
            selection=selection,
            earlier=earlier,
        )
        found: Any = lake.load(trajectory.ref())
        if len(found.left_out_view) == n_left_out:
            break
        earlier, n_left_out = trajectory, len(found.left_out_view)
    return selection, trajectory


def part_pose(request: InspectionRequest, lake: Lake, mesh: Step, cell: Step) -> Pose:
    """Return where the part stands: as written, or resting on the body that the cell file names.

    Raises:
        InvalidInputError: If no such body stands in the world.
    """
    if request.rests_on is None:
        return request.part_pose
    loaded: Any = lake.load(mesh.ref())
    model: Any = lake.load(cell.ref())
    standing = {body.name: body for body in build_cell(model).bodies if body.parent == WORLD}
    if request.rests_on not in standing:
        raise InvalidInputError(
            f"the part rests on {request.rests_on!r}, which does not stand in the cell: use one of {listed(standing)}"
        )
    support = standing[request.rests_on]
    stated = request.part_pose.matrix()
    top = top_height(support.shape, support.T_parent_body)
    return Pose.of(resting_pose(loaded.vertices_m, stated[:3, :3], (stated[0, 3], stated[1, 3]), top))
