"""One door to all layout solvers: `solve_layout`.

A layout is solved from a design by one of several methods and comes back gated, whether it converged or not. The
methods differ in how they look for it, never in what they are asked or how they are judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError, listed
from cellwright.solvers.layout.direct import DirectSettings, solve_direct
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.iterative import IterativeSettings, solve_iteratively
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.proxies import ProxySettings, solve_by_proxy
from cellwright.solvers.layout.relaxation import nearest_clear_design, require_feasible
from cellwright.solvers.layout.second_order import SecondOrderSettings, solve_second_order
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings, solve_staged
from cellwright.solvers.layout.start import sample_design
from cellwright.solvers.layout.symbols import LayoutSymbols

METHODS: dict[str, tuple[Any, Any]] = {
    "direct": (solve_direct, DirectSettings),
    "staged": (solve_staged, StagedSettings),
    "second_order": (solve_second_order, SecondOrderSettings),
    "proxy": (solve_by_proxy, ProxySettings),
    "iterative": (solve_iteratively, IterativeSettings),
}
"""Solvers by name, with their settings' class."""


def solve_layout(
    problem: LayoutProblem,
    method: str = "staged",
    *,
    start: FloatArray | None = None,
    rng: np.random.Generator | None = None,
    settings: Any = None,
    symbols: LayoutSymbols | None = None,
) -> LayoutSolution:
    """Solve a layout problem from one start.

    Args:
        problem: Robot, stations, sequence, obstacles.
        method: `direct` (the paper's equation (4)), `staged` (ours), `second_order` (with acceleration limits), or one
            of the swarms `proxy` (on a proxy objective) and `iterative` (with trajectory optimisation inside).
        start: Design to begin at, (n_design,); by default a random one without overlap.
        rng: For random starts and branches; by default seeded with 0. Equal seeds give equal solutions.
        settings: The method's own settings.
        symbols: The problem's expressions, to share them between calls.

    A given start whose stations overlap is pushed apart; the solution's `notes` say which overlapped, by how much, and
    what the smallest change of the start would have been.

    Raises:
        InvalidInputError: If the method is unknown, or the start has the wrong size or leaves its harnesses' ranges.
        InfeasibleError: If the start overlaps and nothing within the harnesses separates it: what blocks, and the
            smallest relaxation that was found.
    """
    shared = symbols or LayoutSymbols(problem)
    generator = np.random.default_rng(0) if rng is None else rng
    solution = _solved(shared, method, start, generator, settings)
    if start is None or not (overlaps := start_overlaps(problem, start)):
        return solution
    if any(finding.unit == "m" and "overlap" in finding.requirement for finding in solution.report.findings):
        require_feasible(shared, checked_start(problem, start), generator)
    return replace(solution, notes=(*solution.notes, _overlap_note(shared, start, overlaps)))


def _solved(
    symbols: LayoutSymbols, method: str, start: FloatArray | None, rng: np.random.Generator, settings: Any
) -> LayoutSolution:
    problem = symbols.problem
    if method not in METHODS:
        raise InvalidInputError(f"no layout method is called {method!r}: choose one of {', '.join(METHODS)}")
    solve, defaults = METHODS[method]
    own = defaults() if settings is None else settings
    if not isinstance(own, defaults):
        raise InvalidInputError(f"method {method!r} takes {defaults.__name__}, not {type(own).__name__}")
    design = sample_design(problem, rng) if start is None else checked_start(problem, start)
    solution: LayoutSolution = solve(symbols, design, rng, own)
    return solution


def _overlap_note(symbols: LayoutSymbols, start: FloatArray, overlaps: list[str]) -> str:
    """Return what overlaps at a start (n_design,), and the smallest change that would clear it."""
    told = f"the start is not free of overlap, so it was pushed apart: {listed(overlaps)}"
    change = smallest_change(symbols, start)
    return told if change is None else f"{told}; {change}"


def smallest_change(symbols: LayoutSymbols, start: FloatArray) -> str | None:
    """Return in words the smallest change found that clears a start (n_design,) of overlaps; None if none was found."""
    problem, design = symbols.problem, checked_start(symbols.problem, start)
    clear = nearest_clear_design(symbols, design)
    if clear is None:
        return None
    turns = np.concatenate([harness.revolute for harness in problem.harnesses])
    change = clear - design
    changes = [
        f"{problem.design_names[row]} by {change[row]:+.4g} {'rad' if turns[row] else 'm'}"
        for row in np.argsort(-np.abs(change), kind="stable").tolist()
        if abs(change[row]) > 1e-4
    ]
    return f"the smallest change found that clears it: {listed(changes)}"


def solutions_from_starts(
    symbols: LayoutSymbols,
    method: str = "staged",
    *,
    n_starts: int = 5,
    seed: int = 0,
    settings: Any = None,
    start: FloatArray | None = None,
) -> Iterator[LayoutSolution]:
    """Yield the solution of one start after the other, gated or not; the first start may be given.

    A start ``number`` depends on ``[seed, number]`` alone, not on how many there are.

    Raises:
        InvalidInputError: As `solve_layout`, or if no start is asked for.
    """
    if n_starts < 1:
        raise InvalidInputError(f"{n_starts} starts are asked for: give at least one")
    for number in range(n_starts):
        yield _solved(symbols, method, None if number else start, start_generator(seed, number), settings)


def start_generator(seed: int, number: int) -> np.random.Generator:
    """Return the generator of a start: its first draw is the design that it begins at, if none is given."""
    return np.random.default_rng([seed, number])


def best_of(found: Sequence[LayoutSolution]) -> int:
    """Return the row of the best solution: cheapest of those that passed, else of all."""
    return min(
        range(len(found)), key=lambda row: (not found[row].converged, found[row].cycle_time_s + found[row].extra_cost)
    )


def solve_layout_from_starts(
    problem: LayoutProblem,
    method: str = "staged",
    *,
    n_starts: int = 5,
    seed: int = 0,
    settings: Any = None,
    start: FloatArray | None = None,
) -> LayoutSolution:
    """Return the best of several starts: local minima dominate these problems. The first start may be given.

    Raises:
        InvalidInputError: As `solve_layout`.
        InfeasibleError: If no start converges and the stations cannot be served as they stand: what blocks, and the
            smallest relaxation that was found.
    """
    symbols = LayoutSymbols(problem)
    found = list(solutions_from_starts(symbols, method, n_starts=n_starts, seed=seed, settings=settings, start=start))
    best = found[best_of(found)]
    if start is not None and (overlaps := start_overlaps(problem, start)):
        best = replace(best, notes=(*best.notes, _overlap_note(symbols, start, overlaps)))
    if not best.converged:
        require_feasible(symbols, best.design, start_generator(seed, n_starts))
    return best


def checked_start(problem: LayoutProblem, start: FloatArray) -> FloatArray:
    """Return a start design if it fits the problem.

    Raises:
        InvalidInputError: If it has the wrong size or leaves a range; which joint, and by how much.
    """
    design = np.array(start, float)
    if design.shape != (problem.n_design,) or not np.isfinite(design).all():
        raise InvalidInputError(f"the start has shape {design.shape}: give {problem.n_design} finite design joints")
    outside = np.maximum(problem.lower - design, design - problem.upper)
    if (outside > 1e-9).any():
        missed = [f"{problem.design_names[row]} by {outside[row]:.4g}" for row in np.flatnonzero(outside > 1e-9)]
        raise InvalidInputError(f"the start leaves the harness ranges: {listed(missed)}: move it inside")
    return np.asarray(np.clip(design, problem.lower, problem.upper))


def start_overlaps(problem: LayoutProblem, start: FloatArray) -> list[str]:
    """Return what overlaps at a design (n_design,) and by how much, deepest first; empty if nothing does.

    The solvers push overlapping stations apart and say so, but a start without overlap is faster and safer.
    """
    gaps = LayoutGeometry(problem).worst_layout_gaps(checked_start(problem, start))
    return [
        f"{gap.first} and {gap.second} overlap by {-gap.gap_m:.4g} m: move them apart by that"
        for gap in gaps
        if gap.gap_m < 0.0
    ]
