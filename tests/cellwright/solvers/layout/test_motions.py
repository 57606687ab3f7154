"""Programs of any mesh minimise the functional that is measured on their motions, so their costs compare."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.solvers.layout.examples import four_station_problem
from cellwright.solvers.layout.mesh import Checks, build_mesh
from cellwright.solvers.layout.motions import measured_cost, transitions_of
from cellwright.solvers.layout.nlp import LayoutPoint, build_layout_nlp
from cellwright.solvers.layout.problem import LayoutCost
from cellwright.solvers.layout.start import sample_design, segment_times, start_points
from cellwright.solvers.layout.symbols import LayoutSymbols

WEIGHED = replace(four_station_problem(), cost=LayoutCost(manipulability=1.0, along_path=True))
COARSE = build_mesh(WEIGHED, 1)


def straight(seed: int) -> list[np.ndarray]:
    """Return the configurations at every visit of a start."""
    rng = np.random.default_rng(seed)
    point = start_points(WEIGHED, COARSE, sample_design(WEIGHED, rng), rng, 1)[0]
    return [point.q[rows] for rows in COARSE.visit_rows]


@pytest.mark.parametrize("seed", range(3))
def test_straight_motions_cost_the_same_on_every_mesh(seed: int) -> None:
    symbols, visit_q = LayoutSymbols(WEIGHED), straight(seed)
    design = np.zeros(WEIGHED.n_design)
    measured, programmed = [], []
    for n_segments, free_times in ((1, False), (8, True), (100, False)):
        mesh = build_mesh(WEIGHED, n_segments, free_times=free_times)
        q = mesh.interpolated(visit_q)
        point = LayoutPoint(design, q, segment_times(WEIGHED, mesh, q))
        nlp = build_layout_nlp(symbols, mesh, Checks())
        measured.append(measured_cost(WEIGHED, mesh, point))
        programmed.append(float(nlp.program.compiled().cost(nlp.pack(point))))
    np.testing.assert_allclose(measured, measured[0], rtol=1e-9)
    # Gauss's rule misses the kinks where the way leads through a singularity
    np.testing.assert_allclose(programmed, measured[0], rtol=2e-3)


def test_a_slow_segment_counts_for_its_time_at_constant_acceleration_too() -> None:
    symbols, visit_q = LayoutSymbols(WEIGHED), straight(0)
    mesh = build_mesh(WEIGHED, 50)
    q = mesh.interpolated(visit_q)
    rng = np.random.default_rng(0)
    times = segment_times(WEIGHED, mesh, q) * rng.uniform(1.0, 5.0, mesh.n_times)
    point = LayoutPoint(np.zeros(WEIGHED.n_design), q, times, rng.uniform(-0.2, 0.2, q.shape))
    nlp = build_layout_nlp(symbols, mesh, Checks(), order=2)
    # a motion's velocities carry it from point to point only where its program says so: those are measured alone
    lengths = [motion.duration_s for motion in transitions_of(WEIGHED, mesh, point)]
    np.testing.assert_allclose(lengths, times)
    assert float(nlp.program.compiled().cost(nlp.pack(point))) == pytest.approx(
        float(times.sum()) + _mean_by_rows(mesh.transition_rows, point), rel=5e-3
    )


def _mean_by_rows(transition_rows: tuple[np.ndarray, ...], point: LayoutPoint) -> float:
    """Return the mean manipulability over the time with a minus sign, by the trapezoidal rule over the rows."""
    area = 0.0
    for rows, duration in zip(transition_rows, point.times.tolist()):
        J = WEIGHED.arm.jacobian(point.q[rows], WEIGHED.T_flange_tool)
        measure = np.abs(np.linalg.det(J))
        area -= duration * float((0.5 * (measure[1:] + measure[:-1])).mean())
    return area / float(point.times.sum())
