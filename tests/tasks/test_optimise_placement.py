from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from schemas.artefact import digest
from schemas.layout_params import HarnessParams
from schemas.placement import Placement
from schemas.sphere_hull import SphereHull
from schemas.sweep_params import StitchParams, SweepParams
from schemas.views import Measurability
from tasks.fit_spheres import SphereParams, fit_spheres
from tasks.optimise_placement import PlacementParams, optimise_placement
from tasks.stitch_sweeps import stitch_sweeps
from tests.cellwright.solvers import scanning_cell
from tests.cellwright.solvers.placement.placed_sweeps import MARGIN, harness
from tests.tasks.goldens import check_golden
from tests.tasks.scanning_artefacts import PART_POSE, T_WORLD_PART, cell_model, part_mesh, reachability, viewpoints

SWEEPS = SweepParams(step_m=0.01, margin_m=MARGIN, scan_speed_m_s=0.2)
STITCHING = StitchParams(T_world_part=PART_POSE, scan_speed_m_s=0.2, max_alternatives=4, roadmap_nodes=300)
PARAMS = PlacementParams(
    T_world_part=PART_POSE,
    harness=HarnessParams.of(harness()),
    sweeps=SWEEPS,
    stitching=STITCHING,
    n_evaluations=120,
    n_stitched=2,
)


@cache
def measurability() -> Measurability:
    """Every view measures its own sample, in the middle of its travel."""
    n = len(scanning_cell.sweeps())
    useful = scanning_cell.HALF_TRAVEL - MARGIN
    rows = np.arange(n, dtype=np.int32)
    return Measurability(
        view=rows,
        sample=rows,
        uncertainty_m=np.full(n, 5e-5, np.float32),
        start_m=np.full(n, -useful),
        end_m=np.full(n, useful),
        cause=np.zeros(n, np.int8),
    )


@cache
def trajectory() -> Any:
    return stitch_sweeps(
        cell_model(), part_mesh(), viewpoints(), reachability(), scanning_cell.selection(), params=STITCHING
    )


@cache
def hulls() -> tuple[SphereHull, SphereHull]:
    """Spheres of the part and of the cell's bodies."""
    few = SphereParams(n_spheres=4, n_starts=1)
    return fit_spheres(None, part_mesh(), params=few), fit_spheres(cell_model(), None, params=few)


def run(progress: Any = lambda share: None, hulls: tuple[SphereHull, ...] = (), **changes: Any) -> Placement:
    params = PARAMS.model_copy(update=changes)
    inputs = cell_model(), part_mesh(), viewpoints(), measurability(), reachability(), trajectory(), *hulls
    placement: Placement = optimise_placement(*inputs, params=params, progress=progress)
    return placement


@cache
def found() -> Placement:
    return run()


def test_a_better_placement_is_found_and_its_true_cycle_is_shorter() -> None:
    assert found().is_better
    assert 0.5 * found().cycle_before_s < found().bound_before_s <= found().cycle_before_s
    assert found().cycle_before_s == trajectory().time_s[-1]
    assert found().cycle_s == found().trial_cycle_s.min() < found().cycle_before_s
    assert (found().trial_bound_s <= found().trial_cycle_s + 1e-9).all()
    assert np.abs(found().value).max() > 0.0


@cache
def refined() -> Placement:
    """From the best of few designs along the gradient between hulls."""
    return run(hulls=hulls(), n_evaluations=40)


def test_the_gradient_between_hulls_shortens_what_a_short_search_has_found() -> None:
    searched = run(n_evaluations=40)
    assert "gradient" in refined().trial_method and "gradient" not in searched.trial_method
    assert refined().trial_cycle_s.min() < searched.trial_cycle_s.min()
    best = int(np.argmin(refined().trial_cycle_s))
    assert refined().trial_method[best] == "gradient"
    np.testing.assert_array_equal(refined().value, refined().trial_value[best])
    assert refined().cycle_s == refined().trial_cycle_s[best]


def test_without_gradient_steps_the_hulls_only_prove_distances() -> None:
    proven, searched = run(hulls=hulls(), n_evaluations=40, n_refined=0), run(n_evaluations=40)
    np.testing.assert_array_equal(proven.value, searched.value)
    assert len(proven.gap_m) and not len(searched.gap_m)


def test_no_proven_gap_exceeds_the_true_distance_of_the_bodies() -> None:
    import trimesh

    from cellwright.cell.enclosing_mesh import enclosing_mesh
    from schemas.cell_objects import build_cell

    cell = build_cell(cell_model(), part_mesh(), refined().T_world_part)
    bodies = {body.name: body for body in cell.bodies}

    def world(name: str) -> trimesh.Trimesh:
        body = bodies[name]
        T = body.T_parent_body if body.parent < 0 else cell.T_world_base @ body.T_parent_body
        mesh = enclosing_mesh(body.shape)
        return trimesh.Trimesh(mesh.vertices, mesh.faces).apply_transform(T)

    assert set(refined().gap_moved) == {"part"} and len(refined().gap_m) >= 2
    for moved, standing, gap in zip(refined().gap_moved, refined().gap_standing, refined().gap_m.tolist()):
        engine = trimesh.collision.CollisionManager()
        engine.add_object(moved, world(moved))
        assert gap <= engine.min_distance_single(world(standing)) + 1e-9, (moved, standing)


def test_the_pose_is_that_of_the_design_joints() -> None:
    D = harness().poses(found().value)
    np.testing.assert_allclose(found().T_world_motion, D, atol=1e-12)
    np.testing.assert_allclose(found().T_world_part, D @ T_WORLD_PART, atol=1e-12)
    np.testing.assert_array_equal(found().T_world_part_before, PART_POSE.matrix())
    np.testing.assert_array_equal(found().T_world_base, found().T_world_base_before)


def test_moving_the_base_leaves_the_part_where_it_is() -> None:
    at = harness()
    base = run(moves="robot", harness=HarnessParams.of(at), n_evaluations=60)
    np.testing.assert_array_equal(base.T_world_part, base.T_world_part_before)
    np.testing.assert_allclose(base.T_world_base, base.T_world_motion @ base.T_world_base_before, atol=1e-12)


def test_every_refused_design_has_its_cause_and_is_counted() -> None:
    assert 0 < found().refused_count.sum() < found().n_judged <= PARAMS.n_evaluations
    assert found().refused_count.tolist() == sorted(found().refused_count.tolist(), reverse=True)
    assert set(found().refused_test) <= {"overlap", "start collision", "sweep"}
    assert all(cause for test, cause in zip(found().refused_test, found().refused_cause) if test == "sweep")


def test_the_least_estimate_falls() -> None:
    assert (np.diff(found().trace_estimate_s) < 0.0).all() and (np.diff(found().trace_judged) > 0).all()


def test_the_placement_is_the_same_whenever_it_is_searched() -> None:
    assert digest(run()) == digest(found())


def test_another_seed_searches_elsewhere() -> None:
    assert not np.array_equal(run(seed=1).value, found().value)


def test_without_a_better_placement_nothing_moves_and_it_says_why() -> None:
    kept = run(n_evaluations=1)
    assert not kept.is_better and (kept.value == 0.0).all()
    np.testing.assert_array_equal(kept.T_world_part, kept.T_world_part_before)
    assert kept.cycle_s == kept.cycle_before_s
    assert kept.reason == "1 placements were judged, 0 of them cannot execute every sweep, and no other can"


def test_a_gain_that_is_not_worth_it_moves_nothing() -> None:
    kept = run(gain_s=5.0)
    assert not kept.is_better
    assert "which gains nothing" in kept.reason


def test_a_body_that_is_not_there_cannot_be_carried() -> None:
    with pytest.raises(InvalidInputError, match=r"layout.carries names palette, which does not stand .* use one of"):
        run(carries=("palette",))


def test_progress_rises_to_one() -> None:
    shares: list[float] = []
    run(progress=shares.append, n_evaluations=30, n_stitched=1)
    assert shares == sorted(shares) and shares[-1] == 1.0


def decisions(placement: Placement) -> tuple[Any, ...]:
    """What was decided, in figures that end alike on every processor."""
    tried = zip(placement.trial_method, placement.trial_reason, placement.trial_cycle_s.tolist())
    refused = zip(placement.refused_test, placement.refused_what, placement.refused_cause)
    gaps = zip(placement.gap_moved, placement.gap_standing, placement.gap_m.tolist())
    return (
        placement.is_better,
        placement.n_judged,
        np.round(placement.value, 3).tolist(),
        np.round([placement.cycle_before_s, placement.cycle_s, placement.bound_before_s], 2).tolist(),
        np.round([placement.trial_estimate_s, placement.trial_bound_s], 2).tolist(),
        [(method, reason, round(cycle, 2)) for method, reason, cycle in tried],
        sorted(zip(refused, placement.refused_count.tolist())),
        [(moved, standing, round(gap, 3)) for moved, standing, gap in gaps],
    )


def test_the_result_is_the_one_of_this_version() -> None:
    """Decisions alone, of a short search that ends along the gradient, and of one that finds nothing."""
    check_golden(optimise_placement, repr(decisions(refined())), repr(decisions(run(n_evaluations=1))))
