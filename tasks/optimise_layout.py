"""Place stations and robot base for the shortest true cycle time, from several starts; every start is gated.

Local minima dominate these problems, so the best of several starts counts, and all of them are kept to show how they
scatter. A start is random, but for the first where the file says so. If none passes its gate the smallest relaxation
is looked for that would make the layout feasible; the artefact then says what blocks, and flows refuse it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from schemas.layout import Layout, RobotHull
from schemas.layout_objects import build_problem
from schemas.layout_params import LayoutProblemParams
from schemas.params import Params
from schemas.sources import SourceFile
from schemas.sphere_hull import SphereHull
from schemas.stage import Progress, no_progress, stage

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.solvers.layout.problem import LayoutProblem
    from cellwright.solvers.layout.relaxation import Relaxation
    from cellwright.solvers.layout.solution import LayoutSolution, Transition
    from cellwright.solvers.layout.symbols import LayoutSymbols

Method = Literal["staged", "direct", "second_order", "proxy", "iterative"]


class LayoutParams(Params):
    """The problem, and how it is solved."""

    problem: LayoutProblemParams = Field(description="Robot, stations, sequence, obstacles.")
    method: Method = Field(default="staged", description="The solver.")
    proxy: Literal["euclidean", "to robot", "joint", "joint time"] = Field(
        default="joint", description="What the proxy is; with proxy."
    )
    n_segments: int = Field(default=100, ge=1, le=1000, description="N: pieces of a transition.")
    polish: bool = Field(default=True, description="A last program on N pieces; with staged.")
    n_particles: int = Field(default=160, ge=1, description="Particles of a swarm.")
    n_generations: int = Field(default=40, ge=1, description="Generations of a swarm.")
    n_starts: int = Field(default=5, ge=1, le=1000, description="Starts that the best is taken of.")
    placed: bool = Field(default=False, description="Whether the first start is where everything is placed.")
    extras: bool = Field(
        default=True,
        description="Whether the layout is timed where it began, and a relaxation looked for if none passes.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of all random choices.")


@stage(version=4)
def optimise_layout(
    urdf: SourceFile | None,
    robot: RobotHull | None,
    hulls: SphereHull | None,
    *,
    params: LayoutParams,
    progress: Progress = no_progress,
) -> Layout:
    """Optimise a layout.

    ``urdf`` is the robot's unless it is built in; ``robot`` and ``hulls`` are there where links or bodies need them.

    Raises:
        InvalidInputError: If the problem contradicts itself, or stations overlap where the first start is placed.
    """
    from cellwright.solvers.layout.optimiser import best_of, solutions_from_starts, start_generator
    from cellwright.solvers.layout.relaxation import Relaxation, smallest_relaxation
    from cellwright.solvers.layout.start import sample_design
    from cellwright.solvers.layout.symbols import LayoutSymbols

    problem = build_problem(params.problem, urdf, robot, hulls)
    symbols, settings = LayoutSymbols(problem), _settings(params)
    placed = _placed(symbols) if params.placed else None
    # the same generator gives the first start, which is drawn as the solver draws it
    first = sample_design(problem, start_generator(params.seed, 0)) if placed is None else placed
    before = _timed(problem, first, params) if params.extras else None
    found: list[LayoutSolution] = []
    for solution in solutions_from_starts(
        symbols, params.method, n_starts=params.n_starts, seed=params.seed, settings=settings, start=placed
    ):
        found.append(solution)
        progress(len(found) / (params.n_starts + 1))
    best = best_of(found)
    relaxation = Relaxation(())
    if params.extras and not found[best].converged:
        rng = start_generator(params.seed, params.n_starts)
        relaxation = smallest_relaxation(symbols, found[best].design, rng)
    progress(1.0)
    return _layout(problem, found, best, first, before, relaxation)


def _placed(symbols: LayoutSymbols) -> FloatArray | None:
    """Return the design where everything is placed, (n_design,); `None` if nothing separates what overlaps there.

    Raises:
        InvalidInputError: If things overlap there that could stand apart: which, by how much, and the smallest change.
    """
    from cellwright.errors import InvalidInputError, listed
    from cellwright.solvers.layout.optimiser import smallest_change, start_overlaps

    problem = symbols.problem
    # joints move from where things are placed; a range without 0 begins at its nearer end
    design = np.clip(np.zeros(problem.n_design), problem.lower, problem.upper)
    overlaps = start_overlaps(problem, design)
    if not overlaps:
        return np.asarray(design)
    change = smallest_change(symbols, design)
    if change is None:
        return None  # what blocks is found with the smallest relaxation
    raise InvalidInputError(
        f"the layout overlaps where it is placed: {listed(overlaps)}; {change}; or begin elsewhere by "
        "solver.begin: random"
    )


def _timed(problem: LayoutProblem, design: FloatArray, params: LayoutParams) -> LayoutSolution:
    """Return the cycle of a layout as it stands, under the same law of motion."""
    from cellwright.solvers.layout.fixed_layout import time_layout
    from cellwright.solvers.layout.second_order import SecondOrderSettings
    from cellwright.solvers.layout.staged import StagedSettings

    accelerated = params.method == "second_order"
    settings = SecondOrderSettings() if accelerated else StagedSettings(n_branches=3, n_sweeps=0)
    return time_layout(problem, design, np.random.default_rng(params.seed), settings)


def _settings(params: LayoutParams) -> Any:
    from cellwright.solvers.layout.direct import DirectSettings
    from cellwright.solvers.layout.iterative import IterativeSettings
    from cellwright.solvers.layout.proxies import Proxy, ProxySettings
    from cellwright.solvers.layout.second_order import SecondOrderSettings
    from cellwright.solvers.layout.staged import StagedSettings
    from cellwright.solvers.particle_swarm import SwarmSettings

    swarm = SwarmSettings(params.n_particles, params.n_generations)
    match params.method:
        case "staged":
            return StagedSettings(n_segments=params.n_segments, polish=params.polish)
        case "direct":
            return DirectSettings(n_segments=params.n_segments)
        case "second_order":
            return SecondOrderSettings(n_segments=params.n_segments)
        case "proxy":
            return ProxySettings(Proxy(params.proxy), swarm)
        case "iterative":
            return IterativeSettings(swarm=swarm)


def _layout(
    problem: LayoutProblem,
    found: Sequence[LayoutSolution],
    best: int,
    first: FloatArray,
    before: LayoutSolution | None,
    relaxation: Relaxation,
) -> Layout:
    chosen, arm = found[best], problem.arm
    names = ("robot base", *(station.name for station in problem.stations))
    return Layout(
        method=chosen.method,
        converged=chosen.converged,
        blocking=chosen.report.blocking,
        cycle_s=chosen.cycle_time_s,
        transition_s=chosen.transition_s,
        approach_s=chosen.approach_s,
        extra_cost_s=chosen.extra_cost,
        before_cycle_s=before.cycle_time_s if before is not None and before.converged else float("nan"),
        before_blocking="it was not timed" if before is None else before.report.blocking,
        best_start=best,
        design=problem.design_names,
        revolute=np.concatenate([np.zeros(0, bool), *(harness.revolute for harness in problem.harnesses)]),
        lower=problem.lower,
        upper=problem.upper,
        before=first,
        value=chosen.design,
        body=names,
        T_world_body=_poses(problem, chosen.design),
        T_world_body_before=_poses(problem, first),
        joint=arm.joint_names,
        joint_revolute=arm.revolute,
        joint_lower=arm.lower,
        joint_upper=arm.upper,
        joint_speed=arm.max_velocity,
        **_motion_columns(problem, chosen, before),
        **_gate_columns(chosen),
        requirement=tuple(finding.requirement for finding in relaxation.findings),
        excess=np.array([finding.excess for finding in relaxation.findings], float),
        excess_unit=tuple(finding.unit for finding in relaxation.findings),
        trial_converged=np.array([each.converged for each in found]),
        trial_cycle_s=np.array([each.cycle_time_s for each in found]),
        trial_extra_cost_s=np.array([each.extra_cost for each in found], float),
        trial_endpoint_m=np.array([each.report.endpoint_m for each in found]),
        trial_penetration_m=np.array([each.report.path_violation_m for each in found]),
        trial_iterations=np.array([each.iterations for each in found], np.int32),
        trial_blocking=tuple(each.report.blocking for each in found),
    )


def _poses(problem: LayoutProblem, design: FloatArray) -> FloatArray:
    poses = np.concatenate([problem.base_pose(design)[None], problem.station_poses(design)])
    return np.asarray(poses.reshape(-1, 16))


def _motion_columns(problem: LayoutProblem, chosen: LayoutSolution, before: LayoutSolution | None) -> dict[str, Any]:
    n, transitions = problem.arm.n_joints, chosen.transitions
    empty = np.empty((0, n))
    shown = before.transitions if before is not None and before.converged else ()
    return {
        "start_visit": tuple(problem.visit_name(each.start) for each in transitions),
        "end_visit": tuple(problem.visit_name(each.end) for each in transitions),
        "start_row": np.array([each.start for each in transitions], np.int32),
        "end_row": np.array([each.end for each in transitions], np.int32),
        "duration_s": np.array([each.duration_s for each in transitions]),
        "transition": np.repeat(np.arange(len(transitions), dtype=np.int32), [len(each.q) for each in transitions]),
        "time_s": np.concatenate([each.times_s for each in transitions]),
        "position": np.concatenate([each.q for each in transitions]),
        "velocity": np.concatenate([_velocity(each) for each in transitions]),
        "approach_visit": np.repeat(
            np.arange(len(chosen.approach_q), dtype=np.int32), [len(q) for q in chosen.approach_q]
        ),
        "approach_position": np.concatenate(chosen.approach_q),
        "before_transition": np.repeat(np.arange(len(shown), dtype=np.int32), [len(each.q) for each in shown]),
        "before_time_s": np.concatenate([np.empty(0), *(each.times_s for each in shown)]),
        "before_position": np.concatenate([empty, *(each.q for each in shown)]),
        "before_velocity": np.concatenate([empty, *(_velocity(each) for each in shown)]),
    }


def _velocity(motion: Transition) -> FloatArray:
    return np.full_like(motion.q, np.nan) if motion.velocity is None else motion.velocity


def _gate_columns(solution: LayoutSolution) -> dict[str, Any]:
    from cellwright.solvers.layout.gate import GateTolerances

    report, most = solution.report, GateTolerances()
    fastest = most.approach_ratio if solution.approach_s > 0.0 else most.ratio
    rows = [
        ("penetration of the robot on its way", report.path_violation_m, most.path_m, "m"),
        ("penetration among stations, base and walls", report.layout_violation_m, most.layout_m, "m"),
        ("position missed at the ends of transitions", report.endpoint_m, most.endpoint_m, "m"),
        ("angle missed at the ends of transitions", report.endpoint_rad, most.endpoint_rad, "rad"),
        ("position missed along approaches", report.approach_m, most.approach_m + report.endpoint_m, "m"),
        ("angle missed along approaches", report.approach_rad, most.approach_rad + report.endpoint_rad, "rad"),
        ("step of a joint along approaches", report.approach_jump, most.jump, "rad or m"),
        ("excess over joint limits", report.position_excess, most.limit, "rad or m"),
        ("excess over harness ranges", report.design_excess, most.limit, "rad or m"),
        ("joint speed over its limit", report.speed_ratio, 1.0 + fastest, ""),
        ("joint acceleration over its limit", report.acceleration_ratio, 1.0 + fastest, ""),
        ("joint speed over its limit where it is to rest", report.rest_ratio, most.ratio, ""),
        ("time to take up the speed of approaches", report.handover_s, most.blend_s, "s"),
    ]
    return {
        "check": tuple(row[0] for row in rows),
        "found": np.array([row[1] for row in rows], float),
        "permitted": np.array([row[2] for row in rows], float),
        "unit": tuple(row[3] for row in rows),
    }
