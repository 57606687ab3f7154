"""Turn a cell file into the parameters of every stage: the one place that knows both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellwright.errors import InvalidInputError, listed
from flows.cell_params import cell_params
from schemas.body_params import BoxBody
from schemas.cell_file import CellFile, load_cell_file
from schemas.cell_file_layout import carried_bodies, layout_harness
from schemas.cell_file_planner import PlannerSection
from schemas.layout_params import HarnessParams
from schemas.placement import Placement
from schemas.poses import Pose
from schemas.scanner import SensingParams
from schemas.sweep_params import StitchParams, SweepParams
from tasks.assemble_cell import CellModelParams
from tasks.compare_placements import ComparisonParams
from tasks.extend_measurability import ExtensionParams
from tasks.find_gaps import GapParams
from tasks.find_overlaps import OverlapParams
from tasks.fit_spheres import SphereParams
from tasks.measure_coverage import CoverageParams
from tasks.measure_samples import MeasurabilityParams
from tasks.optimise_placement import PlacementParams
from tasks.place_surroundings import SurroundingsParams
from tasks.preprocess_mesh import MeshParams
from tasks.read_source import SourceParams
from tasks.record_plan import RecordingParams
from tasks.sample_surface import SurfaceParams
from tasks.sample_viewpoints import ViewpointParams
from tasks.select_views import SetCoverParams
from tasks.sequence_sweeps import SweepSequenceParams
from tasks.simulate_scan import ScanParams
from tasks.take_sequence import TakenSequenceParams
from tasks.trim_measurability import TrimParams
from tasks.verify_plan import VerifyParams
from tasks.write_report import ReportParams, template_digest

_SEED_STEP = 1_000_003
"""Apart the seeds of the three clouds, so that none of them repeats another's random numbers."""

_PLACED = ("surroundings", "overlaps", "sweeps", "stitching", "verification", "scan", "recording", "report")
"""Settings that hold the pose of the part."""

_HULL_STARTS = 2
"""Starts of each fit of spheres: further ones gain a few percent of volume and take as long again."""

_THINNEST = 0.05
"""Thickness over length below which a box gets no spheres."""

_FEWEST_SAMPLES = 50
"""So that a part of a few millimetres has candidates on each of its faces, whatever the density says."""


class InspectionRequest(BaseModel):
    """Everything that decides an inspection plan, stage by stage."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="Name of the cell.")
    part: SourceParams = Field(description="The workpiece's file.")
    cell_files: tuple[SourceParams, ...] = Field(default=(), description="URDF, its meshes, meshes of other bodies.")
    part_pose: Pose = Field(description="Pose of the part in the world; its height is found if it rests on a body.")
    rests_on: str | None = Field(default=None, description="Body that the part stands on.")
    cell: CellModelParams
    mesh: MeshParams
    surroundings: SurroundingsParams = SurroundingsParams()
    overlaps: OverlapParams = OverlapParams()
    samples: SurfaceParams
    refinement_cloud: SurfaceParams
    refinement_rounds: int = Field(default=3, ge=0, description="Most rounds of closing gaps between the samples.")
    verification_cloud: SurfaceParams
    viewpoints: ViewpointParams
    sensing: MeasurabilityParams
    sweeps: SweepParams
    trimming: TrimParams = TrimParams()
    cover: SetCoverParams
    gaps: GapParams
    extension: ExtensionParams
    stitching: StitchParams
    placement: PlacementParams | None = Field(default=None, description="What may be moved; nothing if left out.")
    part_hull: SphereParams | None = Field(default=None, description="Spheres of the part; only for a layout.")
    cell_hull: SphereParams | None = Field(default=None, description="Spheres of the cell's bodies, for the same.")
    comparison: ComparisonParams = ComparisonParams()
    sequencing: SweepSequenceParams | None = Field(
        default=None, description="By which cost the sweeps are sequenced; as stitched if left out."
    )
    payload_note: str = Field(
        default="", description="What the person should know of a payload if the robot turns out to have no dynamics."
    )
    taken_sequence: TakenSequenceParams = TakenSequenceParams()
    verification: VerifyParams
    scan: ScanParams
    coverage: CoverageParams
    recording: RecordingParams = RecordingParams()
    report: ReportParams

    def placed(self, T_world_part: Pose) -> InspectionRequest:
        """Return the request with the part standing at a pose, said to every stage that has to know."""
        update = {"T_world_part": T_world_part}
        stages = {name: getattr(self, name).model_copy(update=update) for name in _PLACED}
        return self.model_copy(update=stages)

    def moved(self, placement: Placement) -> InspectionRequest:
        """Return the request with part, carried bodies and robot's base where a placement has them."""
        D = placement.T_world_motion
        bodies = tuple(
            body.model_copy(update={"pose": Pose.of(D @ body.pose.matrix())})
            if body.name in placement.carried
            else body
            for body in self.cell.bodies
        )
        base = Pose.of(placement.T_world_base) if placement.moves == "robot" else self.cell.T_world_base
        cell = self.cell.model_copy(update={"bodies": bodies, "T_world_base": base})
        pose = Pose.of(placement.T_world_part)
        return self.placed(pose).model_copy(update={"cell": cell, "part_pose": pose, "rests_on": None})


def request_of(path: Path, overrides: Sequence[str] = ()) -> InspectionRequest:
    """Read a cell file and return the request that it makes.

    Raises:
        InvalidInputError: If the cell file, or a file that it names, is malformed or missing.
    """
    return request_from(load_cell_file(path, overrides))


def request_from(file: CellFile) -> InspectionRequest:
    """Return the request that a cell file makes.

    Raises:
        InvalidInputError: If a file that it names is malformed or missing, or a stage does not take a value.
    """
    try:
        return _request(file)
    except ValidationError as error:  # a stage is stricter than the cell file
        faults = [
            f"{'.'.join(map(str, fault['loc']))}: {fault['msg']} (got {fault['input']!r})" for fault in error.errors()
        ]
        raise InvalidInputError(
            f"{file.path}: {error.title} does not take {listed(faults)}: change the value"
        ) from error


def _request(file: CellFile) -> InspectionRequest:
    planner = file.planner
    sensing = SensingParams(scanner=file.scanner.params(), max_uncertainty_m=planner.measurability.max_uncertainty_m)
    shared = sensing.model_dump()
    reach, density = planner.reachability, planner.sampling.density_per_m2
    cell_files, cell = _cell(file)
    sweeps, stitching = _sweeps(planner), _stitching(planner)
    return InspectionRequest(
        name=file.name,
        part=SourceParams.of(file.part.file),
        cell_files=cell_files,
        part_pose=file.part.pose.pose(),
        rests_on=file.part.rests_on,
        cell=cell,
        mesh=MeshParams(
            unit=file.part.unit,
            scale=file.part.scale,
            up_part=file.part.up_part(),
            critical_angle_rad=planner.sampling.critical_angle_rad,
        ),
        samples=SurfaceParams(
            method=planner.sampling.method, density_per_m2=density, at_least=_FEWEST_SAMPLES, seed=planner.seed
        ),
        refinement_cloud=SurfaceParams(
            density_per_m2=planner.refinement.density_factor * density,
            at_least=math.ceil(planner.refinement.density_factor * _FEWEST_SAMPLES),
            seed=planner.seed + _SEED_STEP,
        ),
        refinement_rounds=planner.refinement.rounds,
        verification_cloud=SurfaceParams(
            density_per_m2=planner.verification_cloud.density_factor * density,
            at_least=math.ceil(planner.verification_cloud.density_factor * _FEWEST_SAMPLES),
            seed=planner.seed + 2 * _SEED_STEP,
        ),
        viewpoints=ViewpointParams(
            standoff_m=planner.viewpoints.standoffs_m(sensing.scanner),
            delta_rot_rad=planner.viewpoints.delta_rot_rad,
            theta_tilt_rad=planner.viewpoints.theta_tilt_rad,
            psi_tilt_rad=planner.viewpoints.psi_tilt_rad,
        ),
        sensing=MeasurabilityParams(**shared),
        sweeps=sweeps,
        cover=SetCoverParams(
            method=planner.selection.method,
            min_coverage=planner.selection.min_coverage,
            max_work=planner.selection.max_work,
            node_limit=planner.selection.node_limit,
            time_limit_s=planner.selection.time_limit_s,
            seed=planner.seed,
        ),
        gaps=GapParams(**shared),
        extension=ExtensionParams(**shared),
        stitching=stitching,
        placement=_placement(file, sweeps, stitching),
        sequencing=_sequencing(file, stitching),
        payload_note=_payload_note(file),
        part_hull=None if file.layout is None else _hull(file, planner.hulls.part_spheres),
        cell_hull=None
        if file.layout is None
        else _hull(file, planner.hulls.body_spheres, dict.fromkeys(_plates(cell), 0)),
        verification=VerifyParams(
            scan_speed_m_s=reach.scan_speed_m_s,
            tool_acceleration_m_s2=planner.stitching.tool_acceleration_m_s2,
            return_to_start=planner.stitching.return_to_start,
        ),
        scan=ScanParams(**shared, noise=planner.scan.noise, seed=planner.seed),
        coverage=CoverageParams(**shared, radius_m=planner.scan.coverage_radius_m),
        report=ReportParams(
            title=planner.report.title or file.name,
            notes=planner.report.notes or "",
            max_uncertainty_m=sensing.max_uncertainty_m,
            scanner=sensing.scanner,
            template_sha256=template_digest(),
        ),
    )


def _sweeps(planner: PlannerSection) -> SweepParams:
    reach = planner.reachability
    return SweepParams(
        step_m=reach.step_m,
        margin_m=reach.margin_m,
        shortest_m=reach.shortest_m,
        scan_speed_m_s=reach.scan_speed_m_s,
        clearance_m=reach.clearance_m,
    )


def _stitching(planner: PlannerSection) -> StitchParams:
    reach = planner.reachability
    return StitchParams(
        method=planner.stitching.method,
        exact_up_to=planner.stitching.exact_up_to,
        max_connections=planner.stitching.max_connections,
        roadmap_nodes=planner.stitching.roadmap_nodes,
        neighbours=planner.stitching.neighbours,
        step_rad=planner.stitching.step_rad,
        max_alternatives=planner.stitching.max_alternatives,
        tool_acceleration_m_s2=planner.stitching.tool_acceleration_m_s2,
        return_to_start=planner.stitching.return_to_start,
        clearance_m=reach.clearance_m,
        scan_speed_m_s=reach.scan_speed_m_s,
        seed=planner.seed,
    )


def _placement(file: CellFile, sweeps: SweepParams, stitching: StitchParams) -> PlacementParams | None:
    layout = file.layout
    if layout is None:
        return None
    return PlacementParams(
        moves=layout.move,
        harness=HarnessParams.of(layout_harness(file)),
        carries=carried_bodies(file),
        sweeps=sweeps,
        stitching=stitching,
        n_evaluations=layout.evaluations,
        n_stitched=layout.stitched,
        seed=file.planner.seed,
    )


def _hull(file: CellFile, n_spheres: int, n_spheres_of: dict[str, int] | None = None) -> SphereParams:
    return SphereParams(
        n_spheres=n_spheres, n_spheres_of=n_spheres_of or {}, n_starts=_HULL_STARTS, seed=file.planner.seed
    )


def _plates(cell: CellModelParams) -> list[str]:
    """Return boxes as thin as floors and walls: few spheres would be as thick as those are long."""
    boxes = [body for body in cell.bodies if isinstance(body, BoxBody)]
    return [box.name for box in boxes if min(box.size_m) < _THINNEST * max(box.size_m)]


def _sequencing(file: CellFile, stitching: StitchParams) -> SweepSequenceParams | None:
    section = file.sequencing
    if section is None:
        return None
    weights, payload = section.weights, section.payload
    return SweepSequenceParams(
        cost=section.cost,
        weight_time_per_s=weights.time_per_s,
        weight_torque_per_n2m2s=weights.torque_per_n2m2s,
        weight_speed_s_per_rad2=weights.speed_s_per_rad2,
        payload_kg=payload.mass_kg,
        payload_centre_m=payload.centre_m or _housing_centre(file),
        n_steps=section.steps,
        max_motions=section.max_motions,
        target_gap=section.target_gap,
        stitching=stitching,
    )


def _payload_note(file: CellFile) -> str:
    """Say that a payload changes nothing where only time counts and no torque can be compared."""
    section = file.sequencing
    if section is None or section.cost != "time" or "payload" not in section.model_fields_set:
        return ""
    return (
        f"{file.path}, sequencing.payload: {section.payload.mass_kg:g} kg change nothing, for sequencing.cost is time "
        "and the robot has no dynamics: state masses (<inertial>) and torque limits (<limit effort=...>) in its URDF "
        "to have torques compared, or leave the payload out"
    )


def _housing_centre(file: CellFile) -> tuple[float, float, float]:
    """Return the middle of the scanner's housing on the flange; the flange's own origin without housing."""
    middles = [body.pose.pose().position_m for body in file.scanner.housing]
    if not middles:
        return (0.0, 0.0, 0.0)
    x, y, z = (math.fsum(each) / len(middles) for each in zip(*middles))
    return (x, y, z)


def _cell(file: CellFile) -> tuple[tuple[SourceParams, ...], CellModelParams]:
    return cell_params(file.robot, file.scanner.mount.pose(), file.scanner.housing, file.bodies(), file.may_touch)
