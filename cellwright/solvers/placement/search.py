"""Search the harness's box for placements with a short estimated cycle: a particle swarm, then steps around the best.

The swarm (`cellwright.solvers.particle_swarm`) starts with one particle in the present placement. A refused design
counts as worse the fewer of the tests it passed, so that the swarm finds its way into the few percent of the box where
every sweep can be executed. Around each of its best distinct places a pattern search (Hooke and Jeeves 1961) goes on:
one step up and down each joint at once, half as far where none helps. Limits are on evaluations, never on time, and
designs are judged in the order in which they were asked for: results depend neither on the clock nor on threads.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError
from cellwright.solvers.particle_swarm import SwarmSettings, minimise
from cellwright.solvers.placement.judge import PlacementJudge, Refusal, Verdict
from cellwright.threads import n_usable_cores

DISTINCT = 0.08
"""Designs are distinct if some joint differs by this share of its range."""
REFUSED = 1e6
"""What a refused design is taken to cost, s, and what each test that it fails adds: more than any cycle."""
SWARM_SHARE = 0.75
"""Share of the evaluations that the swarm gets."""
FIRST_STEP, LAST_STEP = 0.06, 0.002
"""Steps of the pattern search as shares of the joints' ranges."""
WORTH_A_STEP = 1e-3
"""Seconds by which a step must shorten the cycle to be taken."""


@dataclass(frozen=True)
class SearchSettings:
    """How long is searched.

    Attributes:
        n_evaluations: Designs judged, at most.
        n_particles: Particles of the swarm.
        n_kept: Distinct designs that are returned, at most.
    """

    n_evaluations: int = 3000
    n_particles: int = 40
    n_kept: int = 6

    def __post_init__(self) -> None:
        """Check.

        Raises:
            InvalidInputError: If a count is below one.
        """
        if min(self.n_evaluations, self.n_particles, self.n_kept) < 1:
            raise InvalidInputError(
                f"a search of {self.n_evaluations} evaluations, {self.n_particles} particles and {self.n_kept} designs "
                "kept finds nothing: give at least 1 of each"
            )


@dataclass(frozen=True, eq=False)
class FoundDesigns:
    """What the search came to.

    Attributes:
        values: Distinct designs by rising estimate of their cycle, (designs, joints).
        estimate: These estimates in s, (designs,).
        present: Verdict on the present placement.
        refused: How many designs were refused, by test, body or sweep, and `Cause`.
        n_evaluated: Designs judged.
        trace: Evaluations made when the best estimate improved, and that estimate, (improvements, 2).
    """

    values: FloatArray
    estimate: FloatArray
    present: Verdict
    refused: dict[tuple[Refusal, str, int], int]
    n_evaluated: int
    trace: FloatArray


@dataclass(eq=False)
class _Archive:
    """All designs judged so far, in order."""

    values: list[FloatArray] = field(default_factory=list)
    estimate: list[float] = field(default_factory=list)
    refused: Counter[tuple[Refusal, str, int]] = field(default_factory=Counter)
    trace: list[tuple[float, float]] = field(default_factory=list)

    def add(self, values: FloatArray, verdict: Verdict) -> None:
        self.values.append(np.array(values))
        self.estimate.append(verdict.estimate)
        if verdict.refusal is not None:
            self.refused[verdict.refusal, verdict.what, verdict.cause] += 1
        elif not self.trace or verdict.estimate < self.trace[-1][1]:
            self.trace.append((float(len(self.values)), verdict.estimate))

    def distinct(self, span: FloatArray, count: int) -> list[int]:
        """Return the rows of the best designs that are not refused, far enough from each other."""
        kept: list[int] = []
        for row in np.argsort(self.estimate, kind="stable").tolist():
            if not np.isfinite(self.estimate[row]) or len(kept) == count:
                break
            away = [np.max(np.abs(self.values[row] - self.values[other]) / span) for other in kept]
            if not away or min(away) >= DISTINCT:
                kept.append(row)
        return kept


def search_designs(
    judge: PlacementJudge,
    settings: SearchSettings,
    rng: np.random.Generator,
    *,
    n_threads: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> FoundDesigns:
    """Return the most promising distinct designs of a problem; the present one is judged but not among them.

    Args:
        judge: Judges designs.
        settings: How long is searched.
        rng: Source of all randomness.
        n_threads: Threads; as many as cores if left out. The result does not depend on it.
        progress: Hears the share of the evaluations made.
    """
    lower, upper = judge.problem.harness.lower, judge.problem.harness.upper
    span, archive = np.maximum(upper - lower, 1e-12), _Archive()
    present = judge.judge(np.zeros(len(lower)))
    budget = settings.n_evaluations
    with ThreadPoolExecutor(n_threads or n_usable_cores()) as pool:

        def judged(places: FloatArray) -> FloatArray:
            verdicts = list(pool.map(judge.judge, places))
            for place, verdict in zip(places, verdicts):
                archive.add(place, verdict)
            progress(min(1.0, len(archive.values) / budget))
            return np.array([_cost(verdict) for verdict in verdicts])

        n_particles = max(1, min(settings.n_particles, int(SWARM_SHARE * budget)))
        generations = max(1, int(SWARM_SHARE * budget) // n_particles)
        minimise(
            lambda places, _: judged(places),
            lower,
            upper,
            rng,
            SwarmSettings(n_particles=n_particles, n_generations=generations),
            first=np.zeros((1, len(lower))),
        )
        seeds = archive.distinct(span, settings.n_kept)
        for number, row in enumerate(seeds):
            left = (budget - len(archive.values)) // (len(seeds) - number)
            _step_around(judged, archive.values[row], archive.estimate[row], (lower, upper), left)
    kept = [row for row in archive.distinct(span, settings.n_kept + 1) if np.abs(archive.values[row]).max() > 0.0]
    kept = kept[: settings.n_kept]
    return FoundDesigns(
        np.array([archive.values[row] for row in kept]).reshape(-1, len(lower)),
        np.array([archive.estimate[row] for row in kept]),
        present,
        dict(archive.refused),
        len(archive.values),
        np.array(archive.trace).reshape(-1, 2),
    )


def _cost(verdict: Verdict) -> float:
    return verdict.estimate if verdict.refusal is None else REFUSED * (1.0 + verdict.n_untested)


def _step_around(
    judged: Callable[[FloatArray], FloatArray],
    values: FloatArray,
    cycle: float,
    box: tuple[FloatArray, FloatArray],
    n_evaluations: int,
) -> None:
    """Step along each joint from a design to better ones until the steps are small or the evaluations used up."""
    lower, upper = box
    n, step = len(values), FIRST_STEP
    while n_evaluations >= 2 * n and step >= LAST_STEP:
        moves = step * (upper - lower) * np.concatenate([np.eye(n), -np.eye(n)])
        places = np.clip(values + moves, lower, upper)
        costs = judged(places)
        n_evaluations -= 2 * n
        best = int(np.argmin(costs))
        if costs[best] < cycle - WORTH_A_STEP:
            values, cycle = places[best], float(costs[best])
        else:
            step *= 0.5
