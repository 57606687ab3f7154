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
from cellwright.errors import CellwrightError, InfeasibleError, InvalidInputError, SolverError
from flows import findings
from flows.caches import use_own_caches
from flows.cell_keys import with_keys
from flows.cell_picture import placed_part
from flows.execution import Watcher, open_lake
from flows.findings import Findings
from flows.inspection_export import export
from flows.inspection_result import InspectionResult
from flows.placed_plan import PlacedPlan, Prepared, candidates_of, prepare, scanned, stand, verified
from flows.placement_rounds import Hulls, better_placement, cover_with_spheres
from flows.requests import InspectionRequest, request_from
from flows.result_folder import prepared
from flows.runner import Step, Steps, watched
from flows.selection_rounds import Choice, close_gaps, connect_sweeps
from flows.sequenced_plan import sequenced_plan
from schemas.cell_file import CellFile, load_cell_file
from schemas.cell_objects import unpacked_bodies
from schemas.poses import Pose
from storage.lake import Lake

PLANNING_STAGES = frozenset(
    {
        "fit_spheres",
        "sample_surface",
        "sample_viewpoints",
        "measure_samples",
        "follow_sweeps",
        "trim_measurability",
        "select_views",
        "find_gaps",
        "extend_measurability",
        "stitch_sweeps",
        "optimise_placement",
        "sequence_sweeps",
    }
)
"""What the paper's planning time is made of: everything between the mesh and the finished trajectory."""


def is_planning(step_name: str) -> bool:
    """Whether a step counts as planning: the cloud on which the result is judged does not."""
    return step_name.split()[0] in PLANNING_STAGES and step_name != "sample_surface verification"


FINDINGS: ContextVar[list[Findings] | None] = ContextVar("inspection_findings", default=None)
"""Takes what a run without a plan has found out; like a watcher it stays in this process and never travels."""


def run(
    cell_file: Path | CellFile,
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
        cell_file: The cell file, or what was loaded from it.
        overrides: Settings ``path=value`` laid over it, unless it is loaded.
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
    # once: it may be edited while the run goes on
    cell = load_cell_file(cell_file, overrides) if isinstance(cell_file, Path) else cell_file
    request = request_from(cell)
    found: list[Findings] = []
    finding = FINDINGS.set(found)
    try:
        with prepared(out), watched(watcher):
            if direct:
                result = plan_and_record(request, lake, refresh, run_id=uuid.uuid4().hex, direct=True, found=found)
            else:
                from flows.inspection_flow import inspect

                result = inspect(request, lake, sorted(refresh))
    except CellwrightError as error:
        told = with_keys(error, cell, found[0].stage if found else "")
        if found:
            _explain(replace(found[0], error=str(told)), told, out, explain)
        if told is error:
            raise
        raise told from error
    finally:
        FINDINGS.reset(finding)
    if out is not None:
        result.files.update(export(open_lake(lake), result, out))
    return result


def _explain(
    found: Findings, error: CellwrightError, out: Path | None, explain: Callable[[Findings], None] | None
) -> None:
    if out is not None:
        with findings.noting(error, "writing the findings"):
            found = findings.export(found, out)
    if explain is not None:
        with findings.noting(error, "showing the findings"):
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
    facts = {"flow": "inspect", "cell": request.name}
    with Steps(lake_url, refresh=refresh, direct=direct, run_id=run_id, facts=facts) as step:
        try:
            steps = plan_inspection(step, request, lake)
            result = InspectionResult.of(request, lake, run_id, steps, step.records())
        except (InvalidInputError, InfeasibleError, SolverError) as error:
            found.append(findings.find_causes(step, request, lake, run_id, error))
            raise
    return replace(result, notes=tuple(step.notes))


def plan_inspection(step: Steps, request: InspectionRequest, lake: Lake) -> dict[str, Step]:
    """Chain the stages of an inspection; returns the steps by the name of what they make."""
    prepared = prepare(step, request)
    cell = step(tasks.assemble_cell, request.cell, files=prepared.files)
    hulls = cover_with_spheres(step, request, prepared.mesh, cell)
    standing = stand(step, request.placed(part_pose(request, lake, prepared.mesh, cell)), prepared, cell)
    first = Choice(step(tasks.select_views, request.cover, measurability=standing.measurable), standing.measurable)
    candidates = candidates_of(prepared, standing)
    choice = close_gaps(step, request, lake, candidates, first)
    connected = connect_sweeps(step, request, lake, candidates, choice, standing.request.stitching)
    first_plan = scanned(step, prepared, standing, choice, connected)
    placed, compared = better_placement(step, request, lake, prepared, choice, first_plan, hulls)
    plan, sequence = sequenced_plan(step, request, lake, prepared, first_plan, placed)
    return _finished(step, prepared, plan, compared, sequence, hulls)


def _finished(
    step: Steps,
    prepared: Prepared,
    plan: PlacedPlan,
    compared: Step | None,
    sequence: Step | None,
    hulls: Hulls | None,
) -> dict[str, Step]:
    """Verify, record and report the plan where it is to run."""
    request, mesh = plan.standing.request, prepared.mesh
    cell, scan, coverage = plan.standing.cell, plan.scan, plan.coverage
    made: dict[str, Any] = {
        "viewpoints": prepared.viewpoints,
        "reachability": plan.standing.reachability,
        "selection": plan.connected.selection,
        "trajectory": plan.connected.trajectory,
    }
    if plan.verification is None:
        plan = verified(step, prepared, plan)
    verification = plan.verification
    recording = step(
        tasks.record_plan, request.recording, cell=cell, mesh=mesh, trajectory=made["trajectory"], scan=scan
    )
    report = step(
        tasks.write_report,
        request.report,
        mesh=mesh,
        cell=cell,
        cloud=prepared.cloud,
        overlaps=plan.standing.overlaps,
        coverage=coverage,
        measurability=plan.measurable,
        verification=verification,
        scan=scan,
        placement=compared,
        sequence=sequence,
        part_hull=hulls and hulls.part,
        cell_hull=hulls and hulls.cell,
        **made,
    )
    return {
        "cell": cell,
        "mesh": mesh,
        "overlaps": plan.standing.overlaps,
        **made,
        "verification": verification,
        **{name: each for name, each in (("scan", scan), ("coverage", coverage)) if each is not None},
        **{name: each for name, each in (("placement", compared), ("sequence", sequence)) if each is not None},
        **({"part_hull": hulls.part, "cell_hull": hulls.cell} if hulls is not None else {}),
        "recording": recording,
        "report": report,
    }


def part_pose(request: InspectionRequest, lake: Lake, mesh: Step, cell: Step) -> Pose:
    """Return where the part stands: as written, or resting on the body that the cell file names.

    Raises:
        InvalidInputError: If no such body stands in the world.
    """
    if request.rests_on is None:
        return request.part_pose
    loaded: Any = lake.load(mesh.ref())
    model: Any = lake.load(cell.ref())
    return placed_part(request, loaded.vertices_m, unpacked_bodies(model))
