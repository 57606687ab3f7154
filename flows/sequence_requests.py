"""Turn a sequence file into the parameters of every stage: the one place that knows both."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellwright.cell.part import METRES_PER_UNIT
from cellwright.errors import InvalidInputError, listed
from flows.cell_params import cell_params
from schemas.payload import PayloadParams
from schemas.poses import Pose
from schemas.sequence_file import SequenceFile, TaskWeightsSection
from tasks.assemble_cell import CellModelParams
from tasks.generate_alternatives import AlternativeParams
from tasks.list_tasks import TaskListParams, TaskParams
from tasks.read_source import SourceParams
from tasks.record_sequence import SequenceRecordingParams
from tasks.sequence_tasks import DynamicsParams, SequenceParams
from tasks.verify_sequence import SequenceVerifyParams
from tasks.write_sequence_report import SequenceReportParams, sequence_template_digest


class SequenceRequest(BaseModel):
    """Everything that decides a sequence, stage by stage."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="Name of the cell.")
    cell_files: tuple[SourceParams, ...] = Field(default=(), description="URDF, its meshes, meshes of other bodies.")
    table: SourceParams | None = Field(default=None, description="Table of tasks.")
    cell: CellModelParams
    tasks: TaskListParams
    alternatives: AlternativeParams
    sequence: SequenceParams
    verification: SequenceVerifyParams
    recording: SequenceRecordingParams = SequenceRecordingParams()
    report: SequenceReportParams
    notes: tuple[str, ...] = Field(default=(), description="What the person should know beforehand.")


def sequence_request(file: SequenceFile) -> SequenceRequest:
    """Return the request that a sequence file makes.

    Raises:
        InvalidInputError: If a file that it names is malformed or missing, or a stage does not take a value.
    """
    try:
        return _request(file)
    except ValidationError as error:  # a stage is stricter than the file
        faults = [
            f"{'.'.join(map(str, fault['loc']))}: {fault['msg']} (got {fault['input']!r})" for fault in error.errors()
        ]
        raise InvalidInputError(
            f"{file.path}: {error.title} does not take {listed(faults)}: change the value"
        ) from error


def _request(file: SequenceFile) -> SequenceRequest:
    planner = file.planner
    cell_files, cell = cell_params(file.robot, file.tool.tip.pose(), file.tool.bodies, file.bodies(), file.may_touch)
    end = None if isinstance(planner.end, str) else planner.end
    rules: dict[str, Any] = {
        "from_start": planner.start == "home",
        "returns": planner.end == "return",
        "end_rad": end,
    }
    payload = _payload(file)
    return SequenceRequest(
        name=file.name,
        cell_files=cell_files,
        table=None if file.tasks.file is None else SourceParams.of(file.tasks.file),
        cell=cell,
        tasks=_tasks(file),
        alternatives=AlternativeParams(
            max_alternatives=planner.max_alternatives, clearance_m=planner.clearance_m, touches=file.tool.touches
        ),
        sequence=SequenceParams(
            cost=planner.cost,
            motions=planner.motions,
            dynamics=_dynamics(file, payload),
            keep_accelerations=planner.keep_accelerations,
            **rules,
            max_motions=planner.max_motions,
            max_work=planner.max_work,
            target_gap=planner.target_gap,
            clearance_m=planner.clearance_m,
            roadmap_nodes=planner.roadmap_nodes,
            neighbours=planner.neighbours,
            step_rad=planner.step_rad,
            # no point moves further between confirmed states than bodies stay apart
            confirm_step_m=min(max(planner.clearance_m, 1e-3), 2e-3),
            seed=planner.seed,
        ),
        verification=SequenceVerifyParams(
            **rules,
            touches=file.tool.touches,
            by_torque=(by_torque := "optimal_control" in (planner.cost, planner.motions)),
            keep_accelerations=planner.keep_accelerations,
            payload=payload if by_torque else None,
        ),
        report=SequenceReportParams(
            title=file.report.title or file.name,
            notes=file.report.notes or "",
            template_sha256=sequence_template_digest(),
        ),
        notes=tuple(_notes(file)),
    )


def _notes(file: SequenceFile) -> Iterator[str]:
    """Say of a payload that nothing asks for it: whoever weighs a tool expects its torques to be looked at."""
    if file.tool.payload is not None and not _counts_torques(file):
        yield (
            f"{file.path}, tool.payload: {file.tool.payload.mass_kg:g} kg change nothing, for planner.cost is "
            f"{file.planner.cost} and torques are not looked at: write planner.weights ({{}} for the default ones) to "
            "price torques and hear of those above their limits, or set planner.cost to optimal_control"
        )


def _counts_torques(file: SequenceFile) -> bool:
    planner = file.planner
    return planner.weights is not None or "optimal_control" in (planner.cost, planner.motions)


def _payload(file: SequenceFile) -> PayloadParams | None:
    given = file.tool.payload
    return None if given is None else PayloadParams(mass_kg=given.mass_kg, centre_m=given.centre_m)


def _dynamics(file: SequenceFile, payload: PayloadParams | None) -> DynamicsParams | None:
    """Return how dynamics are weighed, nothing where the file does not ask for them."""
    planner = file.planner
    if not _counts_torques(file):
        return None
    weights = planner.weights or TaskWeightsSection()
    return DynamicsParams(
        time_per_s=weights.time_per_s,
        effort=weights.torque_per_n2m2s,
        velocity=weights.speed_s_per_rad2,
        n_steps=planner.steps,
        payload=payload,
    )


def _tasks(file: SequenceFile) -> TaskListParams:
    shared = file.tasks
    rows = []
    for task in shared.list:
        quaternion = None
        if task.direction is None:
            quaternion = task.pose().quaternion
        rows.append(
            TaskParams(
                name=task.name,
                position_m=task.position_m,
                direction=task.direction,
                quaternion=quaternion,
                n_rotations=task.rotations,
                dwell_s=task.dwell_s,
                approach_m=task.approach_m,
                after=task.after,
            )
        )
    return TaskListParams(
        tasks=tuple(rows),
        T_world_tasks=Pose.of(file.T_world_tasks()),
        metres_per_unit=METRES_PER_UNIT[shared.unit],
        n_rotations=shared.rotations,
        dwell_s=shared.dwell_s,
        approach_m=shared.approach_m,
    )
