"""Where layout solvers start: designs without overlap, and configurations on promising branches.

Local minima dominate layout problems, and most of them are branches of the inverse kinematics. For a design every
visit gets its configurations by damped least squares from many random seeds at once (any serial arm, any target), and
the cheapest cycle through them is found exactly by dynamic programming over max|dq|/v; the next best cycles through
other branches are further starts. Poses out of reach get the configurations that come closest: the programs can move
the station.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import inverse
from cellwright.solvers.layout.approach import newton_steps, target_error
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import Mesh
from cellwright.solvers.layout.nlp import LayoutPoint
from cellwright.solvers.layout.problem import LayoutProblem, TargetKind
from cellwright.solvers.layout.sequences import cheapest_walks

_SEEDS = 40
"""Random seeds a pose: they find about six of eight branches of an elbow arm."""
_MOST_WINDINGS = 3
_MOST_CANDIDATES = 160
_REACHED = 1e-6
_SAME = 1e-3
_TRIES = 96
_MISS_COST = 20.0
"""Seconds that a metre or radian of pose error or overlap costs while starts are compared."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Ways to make one visit.

    Attributes:
        q: Configurations at the visit's knots, (candidates, knots, joints).
        error: Pose error plus what lies beyond joint limits, (candidates,).
        sample: Which of several places of the station each belongs to, (candidates,).
    """

    q: FloatArray
    error: FloatArray
    sample: IntArray


def sample_design(problem: LayoutProblem, rng: np.random.Generator) -> FloatArray:
    """Return a random design (n_design,): the first without overlap, else the one that overlaps least.

    The paper advises to spread the stations without initial overlap; so does this.
    """
    designs = rng.uniform(problem.lower, problem.upper, (_TRIES, problem.n_design))
    violation = LayoutGeometry(problem).layout_violation(designs)
    clear = np.flatnonzero(violation <= 0.0)
    return np.asarray(designs[clear[0] if len(clear) else np.argmin(violation)])


def visit_candidates(
    problem: LayoutProblem, mesh: Mesh, designs: FloatArray, rng: np.random.Generator, n_seeds: int = _SEEDS
) -> list[Candidates]:
    """Return the configurations of every visit at designs (samples, n_design); at least one each, reached or not."""
    T_base, T_stations = problem.base_pose(designs), problem.station_poses(designs)
    found: list[Candidates] = []
    for visit, knots in enumerate(mesh.knots):
        approach = problem.approach_of(visit)
        if knots is None or approach is None:
            home = np.repeat(np.asarray(problem.home_q)[None, None], len(designs), axis=0)
            found.append(Candidates(home, np.zeros(len(designs)), np.arange(len(designs))))
            continue
        T_base_station = inverse(T_base) @ T_stations[:, problem.visits[visit].station]
        goals = T_base_station[:, None] @ knots.T_station_tool
        found.append(_of_visit(problem, approach.target, goals, rng, n_seeds))
    return found


def _of_visit(
    problem: LayoutProblem, target: TargetKind, goals: FloatArray, rng: np.random.Generator, n_seeds: int
) -> Candidates:
    """Return candidates for goals (samples, knots, 4, 4)."""
    arm, T_flange_tool = problem.arm, problem.T_flange_tool
    n_samples, n_knots = goals.shape[:2]
    middle = n_knots // 2
    low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    seeds = np.clip(rng.uniform(low, high, (n_samples * n_seeds, arm.n_joints)), arm.lower, arm.upper)
    sample = np.repeat(np.arange(n_samples), n_seeds)
    at_middle = goals[sample, middle]
    q, error = newton_steps(arm, T_flange_tool, seeds, at_middle, target, steps=14, damping=1e-4)
    near = np.abs(error).max(axis=1) < 0.05
    q, sample, at_middle = q[near], sample[near], at_middle[near]
    if len(q):
        q, error = newton_steps(arm, T_flange_tool, q, at_middle, target, steps=8)
        reached = np.abs(error).max(axis=1) < _REACHED
        q, sample = _wound(arm, *_distinct(arm, q[reached], sample[reached]))
    missing = np.setdiff1d(np.arange(n_samples), sample)
    if len(missing):
        away, away_sample = _nearest(problem, target, goals[missing, middle], missing, seeds[:n_seeds])
        q, sample = np.concatenate([q, away]), np.concatenate([sample, away_sample])
    whole = np.empty((len(q), n_knots, arm.n_joints))
    whole[:, middle] = q
    for step in (1, -1):
        for knot in range(middle + step, n_knots if step == 1 else -1, step):
            whole[:, knot], _ = newton_steps(
                arm, T_flange_tool, whole[:, knot - step], goals[sample, knot], target, steps=10
            )
    error = target_error(arm.flange_pose(whole) @ T_flange_tool, goals[sample], target)
    beyond = np.maximum(arm.lower - whole, whole - arm.upper).max(axis=(1, 2))
    residual = np.abs(error).max(axis=(1, 2)) + np.maximum(beyond, 0.0)
    return Candidates(np.clip(whole, arm.lower, arm.upper), residual, sample)


def _nearest(
    problem: LayoutProblem, target: TargetKind, goals: FloatArray, samples: IntArray, seeds: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return a few configurations within limits that come closest to goals (n, 4, 4) that were not reached."""
    n = len(seeds)
    q, error = newton_steps(
        problem.arm,
        problem.T_flange_tool,
        np.tile(seeds, (len(goals), 1)),
        np.repeat(goals, n, axis=0),
        target,
        steps=20,
        damping=1e-3,
        within_limits=True,
    )
    size = np.abs(error).sum(axis=1).reshape(len(goals), n)
    best = np.argsort(size, axis=1, kind="stable")[:, :2]
    rows = (best + n * np.arange(len(goals))[:, None]).ravel()
    return q[rows], np.repeat(samples, best.shape[1])


def _distinct(arm: SerialArm, q: FloatArray, sample: IntArray) -> tuple[FloatArray, IntArray]:
    """Return configurations that differ by more than full turns, turning joints near the middle of their range."""
    middle = 0.5 * (arm.lower + arm.upper)
    turns = np.where(arm.revolute, np.round((q - middle) / (2.0 * math.pi)), 0.0)
    wrapped = q - 2.0 * math.pi * turns
    # on a circle, so that both sides of half a turn are the same
    marks = np.where(arm.revolute, np.cos(wrapped), wrapped), np.where(arm.revolute, np.sin(wrapped), 0.0)
    keys = np.hstack([sample[:, None], *(np.round(mark / _SAME) for mark in marks)]).astype(np.int64)
    _, first = np.unique(keys, axis=0, return_index=True)
    return wrapped[np.sort(first)], sample[np.sort(first)]


def _wound(arm: SerialArm, q: FloatArray, sample: IntArray) -> tuple[FloatArray, IntArray]:
    """Return full-turn shifts within the limits, at most a few a row, those nearest the range's middle first."""
    middle = 0.5 * (arm.lower + arm.upper)
    shifts = [
        (-1, 0, 1) if turning and high - low > 2.0 * math.pi else (0,)
        for turning, low, high in zip(arm.revolute.tolist(), arm.lower.tolist(), arm.upper.tolist())
    ]
    turns = 2.0 * math.pi * np.array(list(itertools.islice(itertools.product(*shifts), 4096)), float)
    rows: list[FloatArray] = []
    owners: list[int] = []
    for row, owner in zip(q, sample.tolist()):
        moved = row + turns
        moved = moved[((moved >= arm.lower) & (moved <= arm.upper)).all(axis=1)]
        away = (np.abs(moved - middle) * arm.revolute).sum(axis=1)
        chosen = moved[np.argsort(away, kind="stable")[:_MOST_WINDINGS]]
        rows.extend(chosen)
        owners.extend([owner] * len(chosen))
    return np.array(rows).reshape(-1, arm.n_joints), np.array(owners, np.int64)


def cheapest_cycles(
    problem: LayoutProblem, candidates: list[Candidates], most: int, designs: FloatArray | None = None
) -> list[tuple[list[FloatArray], list[int], float]]:
    """Return up to ``most`` cycles with different first branches, cheapest first.

    Each is the knots of every visit, the place's sample of every visit, and the time in s. Exact over the candidates:
    shortest paths through their layers, closed for a cyclic sequence. With ``designs`` (samples, n_design) the
    overlap of stations that follow each other costs too.
    """
    speed = problem.arm.max_velocity
    layers = []
    for each in candidates:
        order = np.argsort(each.error > _SAME, kind="stable")[:_MOST_CANDIDATES]
        layers.append(Candidates(each.q[order], each.error[order], each.sample[order]))
    steps = []
    for start, end in problem.transitions:
        slowest = np.zeros((len(layers[start].q), len(layers[end].q)))
        for before, after, fastest in zip(layers[start].q[:, -1].T, layers[end].q[:, 0].T, speed):
            np.maximum(slowest, np.abs(before[:, None] - after) / fastest, out=slowest)
        # what is out of reach costs, so that reached branches win
        step = slowest + _MISS_COST * layers[end].error[None, :]
        if designs is not None:
            overlap = _overlaps(problem, designs, start, end)
            step = step + _MISS_COST * overlap[layers[start].sample[:, None], layers[end].sample[None, :]]
        steps.append(step)
    found = []
    for walk, seconds in cheapest_walks(steps, most, cyclic=problem.cyclic):
        chosen = list(zip(layers, walk.tolist()))
        knots = [layer.q[row] for layer, row in chosen]
        found.append((knots, [int(layer.sample[row]) for layer, row in chosen], seconds))
    return found


def _overlaps(problem: LayoutProblem, designs: FloatArray, start: int, end: int) -> FloatArray:
    """Return the penetration (samples, samples) in m of two visits' stations at any of their places."""
    one, other = problem.visits[start].station, problem.visits[end].station
    n = len(designs)
    if one == other or min(one, other) < 0:
        return np.zeros((n, n))
    poses = problem.station_poses(designs)
    centres = []
    for station in (one, other):
        T, hull = poses[:, station], problem.stations[station].hull
        centres.append(np.einsum("nij,kj->nki", T[:, :3, :3], hull.centres) + T[:, None, :3, 3])
    radii = problem.stations[one].hull.radii[:, None] + problem.stations[other].hull.radii
    if not radii.size:
        return np.zeros((n, n))
    apart = np.linalg.norm(centres[0][:, None, :, None] - centres[1][None, :, None, :], axis=-1)
    return np.asarray(np.maximum(radii + problem.clearance_m - apart, 0.0).max(axis=(2, 3)))


def start_points(
    problem: LayoutProblem, mesh: Mesh, design: FloatArray, rng: np.random.Generator, most: int
) -> list[LayoutPoint]:
    """Return up to ``most`` starts at a design, through different branches, the shortest cycle first."""
    candidates = visit_candidates(problem, mesh, design[None], rng)
    return [
        LayoutPoint(design, q := mesh.interpolated(visit_q), segment_times(problem, mesh, q))
        for visit_q, _, _ in cheapest_cycles(problem, candidates, most)
    ]


def spread_points(
    problem: LayoutProblem, mesh: Mesh, design: FloatArray, rng: np.random.Generator, most: int, n_samples: int
) -> list[LayoutPoint]:
    """Return up to ``most`` starts whose stations stand at the best of ``n_samples`` random places each.

    One shortest cycle through places and branches of all visits at once. Stations that are visited more than once,
    and the base, stay where ``design`` has them; where nothing is left to place there are no such starts.
    """
    counts = np.bincount([visit.station for visit in problem.visits if visit.station >= 0], minlength=1)
    parts = problem.design_slices()
    free = [s for s in range(len(problem.stations)) if s < len(counts) and counts[s] == 1]
    if not any(problem.stations[station].harness.n_joints for station in free):
        return []
    designs = np.tile(design, (n_samples, 1))
    for station in free:
        part = parts[station + 1]
        designs[1:, part] = rng.uniform(
            problem.lower[part], problem.upper[part], (n_samples - 1, part.stop - part.start)
        )
    candidates = visit_candidates(problem, mesh, designs, rng, _SEEDS // 2)
    found = []
    for visit_q, samples, _ in cheapest_cycles(problem, candidates, most, designs):
        chosen = design.copy()
        for visit, sample in zip(problem.visits, samples):
            if visit.station in free:
                part = parts[visit.station + 1]
                chosen[part] = designs[sample, part]
        q = mesh.interpolated(visit_q)
        found.append(LayoutPoint(chosen, q, segment_times(problem, mesh, q)))
    return found


def segment_times(problem: LayoutProblem, mesh: Mesh, q: FloatArray) -> FloatArray:
    """Return the shortest times (n_times,) at which joint speeds keep their limits along configurations ``q``."""
    times = np.zeros(mesh.n_times)
    for rows, which, share in zip(mesh.transition_rows, mesh.segment_time, mesh.segment_share):
        needed = (np.abs(np.diff(q[rows], axis=0)) / problem.arm.max_velocity).max(axis=1) / share
        np.maximum.at(times, which, needed)
    return np.maximum(times, 1e-3)
