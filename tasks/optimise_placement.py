"""Find where part or robot should stand so that the selected sweeps take the shortest cycle, all of them in full.

After Baumgaertner 2025: the selected sweeps are the approach trajectories; what moves stands on a harness of design
joints. Thousands of designs are judged by tests that only refuse what cannot be executed, and ranked by an estimate of
their cycle (`cellwright.solvers.placement.judge`). The most promising distinct ones are followed exactly and stitched
into true plans, but for those that provably cannot win, and the shortest of these wins if it beats the present one.
With hulls of spheres the best are gone on from along the gradient of their whole cycle
(`cellwright.solvers.placement.refinement`): what that leads to is judged and stitched like the others. The hulls also
prove how far what moves keeps from what stands. Sight is not looked at here: whoever takes the placement measures
again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from cellwright.arrays import FloatArray
from schemas.layout_params import HarnessParams
from schemas.motion import Trajectory
from schemas.params import Params
from schemas.part import PartMesh
from schemas.placement import Placement, motion_words
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.sphere_hull import SphereHull
from schemas.stage import Progress, no_progress, stage
from schemas.sweep_params import StitchParams, SweepParams
from schemas.views import Measurability, Reachability, Viewpoints

if TYPE_CHECKING:
    from cellwright.solvers.layout.bodies import Spheres
    from cellwright.solvers.placement.problem import PlacementProblem
    from cellwright.solvers.placement.search import FoundDesigns
    from cellwright.solvers.placement.trial import Trial

SEARCHING, STITCHING = 0.6, 0.9
"""Shares of the progress at which designs are judged, and stitched."""


class PlacementParams(Params):
    """Settings of the layout stage."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    moves: Literal["part", "robot"] = Field(default="part", description="What moves on the harness.")
    harness: HarnessParams = Field(description="Motion of it in the world; the identity at zero.")
    carries: tuple[str, ...] = Field(default=(), description="Bodies that move along with the part.")
    sweeps: SweepParams = Field(default=SweepParams(), description="How sweeps are followed.")
    stitching: StitchParams = Field(default=StitchParams(), description="How sweeps are connected.")
    n_evaluations: int = Field(default=3000, ge=1, le=1_000_000, description="Designs judged, at most.")
    n_stitched: int = Field(default=6, ge=1, le=100, description="Designs stitched into whole plans, at most.")
    n_refined: int = Field(default=3, ge=0, le=100, description="Of them gone on from along the gradient, at most.")
    gain_s: float = Field(default=0.01, gt=0, description="Seconds by which a placement must shorten the cycle.")
    resting_m: float = Field(default=1e-3, ge=0, description="Depth at which bodies still count as resting in contact.")
    seed: int = Field(default=0, ge=0, description="Seed of the search.")


@stage(version=3)
def optimise_placement(
    cell: CellModel,
    mesh: PartMesh,
    viewpoints: Viewpoints,
    measurability: Measurability,
    reachability: Reachability,
    trajectory: Trajectory,
    part_hull: SphereHull | None = None,
    cell_hull: SphereHull | None = None,
    *,
    params: PlacementParams,
    progress: Progress = no_progress,
) -> Placement:
    """Find the placement with the shortest cycle through the sweeps that the trajectory executes.

    Args:
        cell: The cell.
        mesh: The part.
        viewpoints: Candidate views.
        measurability: What they measure with unlimited travel.
        reachability: Their executable pieces.
        trajectory: The plan in the present placement.
        part_hull: Spheres that hold the part; without both hulls no gradient is followed.
        cell_hull: Spheres that hold the bodies of the cell.
        params: Settings.
        progress: Hears the share done.

    Raises:
        InvalidInputError: If a body that is to be carried does not stand in the world.
    """
    from schemas.placement_objects import placement_problem

    problem = placement_problem(
        cell,
        mesh,
        viewpoints,
        measurability,
        reachability,
        trajectory,
        T_world_part=params.T_world_part.matrix(),
        harness=params.harness.harness(),
        moves_base=params.moves == "robot",
        carried=params.carries,
        follow=params.sweeps.settings(),
        stitch=params.stitching.settings(),
        resting=params.resting_m,
    )
    now = float(trajectory.time_s[-1]) if len(trajectory.time_s) else 0.0
    if not problem.names or problem.harness.n_joints == 0:
        return _placement(params, problem, _Searched(now))
    return _placement(params, problem, _searched(params, problem, now, part_hull, cell_hull, progress))


@dataclass(frozen=True, eq=False)
class _Searched:
    """What a search came to.

    ``now`` is the present cycle in s, ``bound_now`` what no plan there undercuts, ``least`` what none undercuts at the
    designs found.
    """

    now: float
    bound_now: float = 0.0
    least: float = 0.0
    found: FoundDesigns | None = None
    trials: tuple[Trial, ...] = ()
    hulls: Mapping[str, Spheres] = field(default_factory=dict)

    def better(self, gain: float) -> Trial | None:
        """Return the trial with the shortest cycle if it gains enough (s)."""
        best = min(self.trials, key=lambda trial: trial.cycle, default=None)
        return best if best is not None and best.cycle < self.now - gain else None


def _searched(
    params: PlacementParams,
    problem: PlacementProblem,
    now: float,
    part_hull: SphereHull | None,
    cell_hull: SphereHull | None,
    progress: Progress,
) -> _Searched:
    """Search for designs, stitch the most promising ones, and go on from the best along the gradient."""
    from cellwright.solvers.placement.judge import PlacementJudge
    from cellwright.solvers.placement.refined_trials import refine_trials
    from cellwright.solvers.placement.search import SearchSettings, search_designs
    from cellwright.solvers.placement.trial import TrialSettings, try_designs
    from schemas.sphere_hull_objects import spheres_by_body

    judge = PlacementJudge(problem)
    found = search_designs(
        judge,
        SearchSettings(n_evaluations=params.n_evaluations, n_kept=params.n_stitched),
        np.random.default_rng(params.seed),
        progress=lambda share: progress(SEARCHING * share),
    )
    settings = TrialSettings(params.stitching.settings(), params.stitching.method, params.stitching.seed)
    trials = try_designs(
        judge,
        found,
        settings,
        cycle_now=now - params.gain_s,
        progress=lambda share: progress(SEARCHING + (STITCHING - SEARCHING) * share),
    )
    hulls = spheres_by_body([hull for hull in (part_hull, cell_hull) if hull is not None])
    if part_hull is not None and cell_hull is not None and params.n_refined:
        trials += refine_trials(
            judge,
            trials,
            hulls,
            settings,
            most=params.n_refined,
            gain=params.gain_s,
            progress=lambda share: progress(STITCHING + (1.0 - STITCHING) * share),
        )
    progress(1.0)
    least = min((judge.bound(values) for values in found.values), default=np.inf)
    bound_now = judge.bound(np.zeros(problem.harness.n_joints))
    return _Searched(now, bound_now, least, found, tuple(trials), hulls)


def _placement(params: PlacementParams, problem: PlacementProblem, searched: _Searched) -> Placement:
    """Return the artefact: the best trial if it gains enough, else the present placement and why."""
    harness, found = problem.harness, searched.found
    better = searched.better(params.gain_s)
    values = np.zeros(harness.n_joints) if better is None else better.values
    return Placement(
        joint=harness.names,
        turns=harness.revolute,
        value=values,
        lower=harness.lower,
        upper=harness.upper,
        carried=params.carries,
        **_poses(params, problem, values),
        **_refused(found),
        trace_judged=np.zeros(0, np.int64) if found is None else found.trace[:, 0].astype(np.int64),
        trace_estimate_s=np.zeros(0) if found is None else found.trace[:, 1],
        **_trials(searched.trials, harness.n_joints),
        **_gaps(problem, searched.hulls, values),
        moves=params.moves,
        is_better=better is not None,
        reason=_reason(problem, searched, better),
        cycle_before_s=searched.now,
        cycle_s=searched.now if better is None else better.cycle,
        bound_before_s=searched.bound_now,
        n_judged=0 if found is None else found.n_evaluated,
    )


def _poses(params: PlacementParams, problem: PlacementProblem, values: FloatArray) -> dict[str, Any]:
    """Return the columns of the poses of part and base, present and found."""
    motion = problem.motion(values) if len(values) else np.eye(4)
    part, base, moves_base = params.T_world_part.matrix(), problem.cell.T_world_base, params.moves == "robot"
    return {
        "T_world_part_before": part,
        "T_world_part": part if moves_base else motion @ part,
        "T_world_base_before": base,
        "T_world_base": motion @ base if moves_base else base,
        "T_world_motion": motion,
    }


def _trials(trials: Sequence[Trial], n_joints: int) -> dict[str, Any]:
    """Return the columns of what was stitched."""
    return {
        "trial_value": np.array([trial.values for trial in trials]).reshape(-1, n_joints),
        "trial_estimate_s": np.array([trial.estimate for trial in trials], float),
        "trial_bound_s": np.array([trial.bound for trial in trials], float),
        "trial_cycle_s": np.array([trial.cycle for trial in trials], float),
        "trial_reason": tuple(trial.reason for trial in trials),
        "trial_method": tuple(trial.method for trial in trials),
    }


def _gaps(problem: PlacementProblem, hulls: Mapping[str, Spheres], values: FloatArray) -> dict[str, Any]:
    """Return the columns of the proven distances."""
    from cellwright.solvers.placement.refinement import proven_gaps

    gaps = proven_gaps(problem, hulls, values)
    return {
        "gap_moved": tuple(moved for moved, _ in gaps),
        "gap_standing": tuple(standing for _, standing in gaps),
        "gap_m": np.array(list(gaps.values()), float),
    }


def _refused(found: FoundDesigns | None) -> dict[str, Any]:
    """Return the columns of what refused designs, the most frequent first."""
    from cellwright.causes import Cause

    refused = {} if found is None else found.refused
    order = sorted(refused, key=lambda key: (-refused[key], key[0].value, key[1], key[2]))
    return {
        "refused_test": tuple(test.value for test, _, _ in order),
        "refused_what": tuple(what for _, what, _ in order),
        "refused_cause": tuple(Cause(cause).label if cause else "" for _, _, cause in order),
        "refused_count": np.array([refused[key] for key in order], np.int64),
    }


def _reason(problem: PlacementProblem, searched: _Searched, better: Trial | None) -> str:
    found, trials, now = searched.found, searched.trials, searched.now
    if found is None:
        return "no sweep is executed, so there is no cycle to shorten"
    n_refused = sum(found.refused.values())
    judged = f"{found.n_evaluated:,} placements were judged, {n_refused:,} of them cannot execute every sweep"
    if better is not None:
        words = motion_words(problem.harness.names, problem.harness.revolute, better.values)
        return f"{judged}; {words} shortens the cycle by {now - better.cycle:.2f} s"
    if not len(found.values):
        return f"{judged}, and no other can"
    stitched = [trial.cycle for trial in trials if np.isfinite(trial.cycle)]
    if stitched:
        return (
            f"{judged}; the best of {len(trials)} stitched ones takes {min(stitched):.2f} s, not less than {now:.2f} s"
        )
    if trials:
        return f"{judged}; none of the {len(trials)} stitched ones can be executed in full ({trials[0].reason})"
    return (
        f"{judged}; none of the {len(found.values)} most promising ones can take less than {searched.least:.2f} s, "
        f"which gains nothing on {now:.2f} s"
    )
