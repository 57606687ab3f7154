"""The check of a layout on a dense time grid, made of numbers alone: it shares no expression with the solvers.

Soft endpoints can cheat by centimetres and coarse grids cut into obstacles, so nothing that a program says of itself
counts. Every transition is sampled each millisecond, every approach each 5 mm (`measures`); `judge` names what misses
its tolerance.

With acceleration limits a transition begins and ends at rest, or at the speed of the timed approach beside it. What is
left between the two, and what an approach asks for at its corners, the joints have to take up within `blend_s`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.approach import JUMP
from cellwright.solvers.layout.geometry import LayoutGap, LayoutGeometry
from cellwright.solvers.layout.measures import (
    LayoutMeasures,
    Worst,
    beyond_range,
    followed_approaches,
    measure_layout,
)
from cellwright.solvers.layout.mesh import Mesh
from cellwright.solvers.layout.solution import Finding, GateReport, Transition


@dataclass(frozen=True)
class GateTolerances:
    """What a solution may miss and still count as converged.

    Attributes:
        path_m: Penetration along the path: what a polished path may dip between the points of its program.
        layout_m: Penetration among stations, base and walls.
        endpoint_m, endpoint_rad: Tool pose at the ends of transitions.
        approach_m, approach_rad: Tool pose along an approach.
        jump: Step of a joint between neighbours along an approach, rad or m.
        limit: Excess over position and design limits, rad or m.
        ratio: Excess of speed and acceleration ratios over 1, and of speeds at rest over 0.
        approach_ratio: The same along timed approaches, which the programs know by their knots only.
        blend_s: Time in which joints may take up a step in speed on and beside timed approaches: they have corners.
        step_s: Time step of the grid.
    """

    path_m: float = 1e-3
    layout_m: float = 1e-4
    endpoint_m: float = 5e-4
    endpoint_rad: float = 1e-3
    approach_m: float = 1e-4
    approach_rad: float = 1e-4
    jump: float = JUMP
    limit: float = 1e-6
    ratio: float = 1e-5
    approach_ratio: float = 0.05
    blend_s: float = 0.02
    step_s: float = 1e-3


def check_layout(
    geometry: LayoutGeometry,
    mesh: Mesh,
    design: FloatArray,
    visit_q: Sequence[FloatArray],
    transitions: Sequence[Transition],
    tolerances: GateTolerances,
) -> tuple[GateReport, tuple[FloatArray, ...]]:
    """Measure and judge a solution; return the configurations at every pose of every visit's approach too.

    ``visit_q`` holds the configurations at each visit's knots.
    """
    accelerated = all(each.velocity is not None for each in transitions)
    followed = followed_approaches(geometry.problem, mesh, design, visit_q, smooth=accelerated)
    measures = measure_layout(
        geometry, design, visit_q, followed, transitions, step_s=tolerances.step_s, blend_s=tolerances.blend_s
    )
    at_poses = tuple(visit_q[visit] if each is None else each.q for visit, each in enumerate(followed))
    return judge(measures, tolerances), at_poses


def judge(found: LayoutMeasures, tolerances: GateTolerances) -> GateReport:
    """Return the report of what was measured, with a finding for everything that misses its tolerance."""
    touching = Limit(
        f"{found.pair[0]} enters {found.pair[1]} {found.path.name}", found.path.value, tolerances.path_m, "m"
    )
    limits = (
        touching,
        *_overlaps(found.gaps, tolerances),
        *_pose_limits(found, tolerances),
        *_rate_limits(found, tolerances),
    )
    return GateReport(
        found.path.value,
        found.pair,
        _violation(found.gaps),
        found.position.value,
        found.turn.value,
        found.approach_position.value,
        found.approach_turn.value,
        found.jump.value,
        max(found.joint.value, 0.0),
        max(found.design.value, 0.0),
        max(found.speed.value, found.approach_speed.value),
        max(found.acceleration.value, found.approach_acceleration.value),
        found.rest.value,
        found.handover.value,
        found.n_samples,
        _missed(limits),
    )


def rejudge_design(
    report: GateReport, geometry: LayoutGeometry, design: FloatArray, tolerances: GateTolerances
) -> GateReport:
    """Return the report of a layout that was held fixed, its design judged by the problem in which it may move.

    Bodies that stand still are not compared with each other, so a fixed layout alone does not tell their overlaps.
    """
    gaps, outside = tuple(geometry.worst_layout_gaps(design)), beyond_range(geometry.problem, design)
    limits = [*_overlaps(gaps, tolerances), _range_limit(outside, tolerances)]
    missed = _missed(limits)
    known = {finding.requirement for finding in missed}
    return replace(
        report,
        layout_violation_m=max(report.layout_violation_m, _violation(gaps)),
        design_excess=max(outside.value, 0.0),
        findings=(*missed, *(finding for finding in report.findings if finding.requirement not in known)),
    )


@dataclass(frozen=True)
class Limit:
    """What a requirement measures, by how much it may exceed ``nominal`` (1 for a ratio to a limit), and the unit."""

    requirement: str
    value: float
    most: float
    unit: str
    nominal: float = 0.0


def _missed(limits: Sequence[Limit]) -> tuple[Finding, ...]:
    return tuple(
        Finding(each.requirement, each.value - each.nominal, each.unit)
        for each in limits
        if not each.value - each.nominal <= each.most
    )


def _violation(gaps: Sequence[LayoutGap]) -> float:
    return max(-gaps[0].gap_m, 0.0) if gaps else 0.0


def _overlaps(gaps: Sequence[LayoutGap], most: GateTolerances) -> list[Limit]:
    return [Limit(f"{gap.first} and {gap.second} overlap", -gap.gap_m, most.layout_m, "m") for gap in gaps]


def _range_limit(design: Worst, most: GateTolerances) -> Limit:
    return Limit(f"{design.name} leaves its range", design.value, most.limit, design.unit)


def _pose_limits(found: LayoutMeasures, most: GateTolerances) -> list[Limit]:
    turned = "home" if found.turn.name == "home" else f"the orientation at {found.turn.name}"
    position_m, turn_rad = found.position.value, found.turn.value
    followed, aligned, jumping = found.approach_position, found.approach_turn, found.jump
    return [
        Limit(f"{found.position.name} is not met", position_m, most.endpoint_m, "m"),
        Limit(f"{turned} is not met", turn_rad, most.endpoint_rad, "rad"),
        Limit(
            f"the joints jump between approach and transition at {found.seam.name}",
            found.seam.value,
            most.limit,
            found.seam.unit,
        ),
        Limit(f"the arm jumps on the approach of {jumping.name}", jumping.value, most.jump, jumping.unit),
        Limit(f"the approach of {followed.name} is not followed", followed.value, most.approach_m + position_m, "m"),
        Limit(
            f"the orientation along the approach of {aligned.name} is not met",
            aligned.value,
            most.approach_rad + turn_rad,
            "rad",
        ),
        Limit(f"{found.joint.name} leaves its limits", found.joint.value, most.limit, found.joint.unit),
        _range_limit(found.design, most),
    ]


def _rate_limits(found: LayoutMeasures, most: GateTolerances) -> list[Limit]:
    speed, acceleration = "of its speed limit", "of its acceleration limit"
    on_approach = f"on the approach of {found.approach_speed.name}"
    accelerated = f"on the approach of {found.approach_acceleration.name}"
    return [
        Limit(f"{found.speed.name} is too fast", found.speed.value, most.ratio, speed, 1.0),
        Limit(f"a joint is too fast {on_approach}", found.approach_speed.value, most.approach_ratio, speed, 1.0),
        Limit(
            f"{found.acceleration.name} accelerates too much", found.acceleration.value, most.ratio, acceleration, 1.0
        ),
        Limit(
            f"a joint accelerates too much {accelerated}",
            found.approach_acceleration.value,
            most.approach_ratio,
            acceleration,
            1.0,
        ),
        Limit(f"the arm does not stand still at {found.rest.name}", found.rest.value, most.ratio, speed),
        Limit(
            f"the joints take up the speed of the approach of {found.handover.name} too slowly",
            found.handover.value,
            0.0,
            "s",
            most.blend_s,
        ),
    ]
