"""The steps of a plan in one placement: what depends on where part and robot stand, from their sight to the scan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import tasks
from flows.requests import InspectionRequest
from flows.runner import Step, Steps
from flows.selection_rounds import Candidates, Choice, Connected


@dataclass(frozen=True)
class Prepared:
    """The steps that stay the same wherever anything stands."""

    files: tuple[Step, ...]
    mesh: Step
    cloud: Step
    samples: Step
    viewpoints: Step


@dataclass(frozen=True)
class Standing:
    """A cell in one placement: what its candidates see there, and what the arm can execute.

    ``request`` has the pose of the part in the settings of every stage.
    """

    request: InspectionRequest
    cell: Step
    surroundings: Step
    overlaps: Step
    seen: Step
    reachability: Step
    measurable: Step


@dataclass(frozen=True)
class PlacedPlan:
    """A plan in one placement, its simulated scan, and what that covers; without a motion there is no scan."""

    standing: Standing
    measurable: Step
    connected: Connected
    scan: Step | None = None
    coverage: Step | None = None
    verification: Step | None = None


def prepare(step: Steps, request: InspectionRequest) -> Prepared:
    """Read and sample the part; read the files of the cell."""
    part = step(tasks.read_source, request.part, label="part")
    files = tuple(step(tasks.read_source, source, label=source.name) for source in request.cell_files)
    mesh = step(tasks.preprocess_mesh, request.mesh, source=part)
    cloud = step(tasks.sample_surface, request.verification_cloud, label="verification", mesh=mesh)
    samples = step(tasks.sample_surface, request.samples, label="planning", mesh=mesh)
    viewpoints = step(tasks.sample_viewpoints, request.viewpoints, samples=samples)
    return Prepared(files, mesh, cloud, samples, viewpoints)


def stand(step: Steps, request: InspectionRequest, prepared: Prepared, cell: Step, *, label: str = "") -> Standing:
    """Find what the candidates see and execute in a placement; ``request`` says where the part stands."""
    mesh, viewpoints = prepared.mesh, prepared.viewpoints
    surroundings = step(tasks.place_surroundings, request.surroundings, label=label, cell=cell)
    overlaps = step(tasks.find_overlaps, request.overlaps, label=label, cell=cell, mesh=mesh)
    seen = step(
        tasks.measure_samples,
        request.sensing,
        label=label,
        mesh=mesh,
        surroundings=surroundings,
        samples=prepared.samples,
        viewpoints=viewpoints,
    )
    reachability = step(
        tasks.follow_sweeps,
        request.sweeps,
        label=label,
        cell=cell,
        mesh=mesh,
        viewpoints=viewpoints,
        measurability=seen,
    )
    measurable = step(
        tasks.trim_measurability,
        request.trimming,
        label=label,
        samples=prepared.samples,
        viewpoints=viewpoints,
        measurability=seen,
        reachability=reachability,
    )
    return Standing(request, cell, surroundings, overlaps, seen, reachability, measurable)


def candidates_of(prepared: Prepared, standing: Standing) -> Candidates:
    """Return what rounds of selecting views draw on."""
    return Candidates(standing.cell, prepared.mesh, standing.surroundings, prepared.viewpoints, standing.reachability)


def verified(step: Steps, prepared: Prepared, plan: PlacedPlan, *, label: str = "") -> PlacedPlan:
    """Return a plan with its verification.

    Raises:
        UnsafePlanError: If it fails.
    """
    standing, connected = plan.standing, plan.connected
    verification = step(
        tasks.verify_plan,
        standing.request.verification,
        label=label,
        cell=standing.cell,
        mesh=prepared.mesh,
        viewpoints=prepared.viewpoints,
        reachability=standing.reachability,
        selection=connected.selection,
        trajectory=connected.trajectory,
    )
    verification.ref()
    return replace(plan, verification=verification)


def scanned(
    step: Steps, prepared: Prepared, standing: Standing, choice: Choice, connected: Connected, *, label: str = ""
) -> PlacedPlan:
    """Execute a plan virtually and measure what it covers."""
    scan = step(
        tasks.simulate_scan,
        standing.request.scan,
        label=label,
        cell=standing.cell,
        mesh=prepared.mesh,
        surroundings=standing.surroundings,
        trajectory=connected.trajectory,
    )
    coverage = step(
        tasks.measure_coverage,
        standing.request.coverage,
        label=label,
        mesh=prepared.mesh,
        surroundings=standing.surroundings,
        cloud=prepared.cloud,
        scan=scan,
        viewpoints=prepared.viewpoints,
        reachability=standing.reachability,
        selection=connected.selection,
        trajectory=connected.trajectory,
    )
    return PlacedPlan(standing, choice.measurable, connected, scan, coverage)
