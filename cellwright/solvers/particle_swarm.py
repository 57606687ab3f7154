"""Minimise any function on a box by a particle swarm (Kennedy and Eberhart 1995; Bratton and Kennedy 2007).

A particle is drawn to the best place that it has seen and to the best that its neighbours have seen::

    v <- chi (v + phi_own r1 (own - x) + phi_near r2 (near - x)),    x <- x + v

with r1, r2 fresh uniform numbers a particle and dimension. Baumgaertner 2025 configures its swarm "according to" Chen,
Montgomery, Bolufe-Roehler 2015 with 160 particles over 40 generations and prints no coefficient; that study starts
from the standard swarm of Bratton and Kennedy 2007, so that is what the defaults are: the constriction coefficient
chi = 0.72984 for phi_own = phi_near = 2.05 (Clerc and Kennedy 2002), a ring in which a particle knows its two
neighbours, no velocity at the start, and particles that leave the box are mirrored back into it and stopped there.

The best value never rises from one generation to the next. Same generator, same function: same result, bit by bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.errors import InvalidInputError

Objective = Callable[[FloatArray, FloatArray], FloatArray]
"""Values (n,) of positions (n, dimensions). The second argument (n,) is the value that each position has to beat: where
that is hopeless any number not below it may be returned, so that an expensive function can stop early without
changing the result. Infinity is a value; not-a-number is not."""


@dataclass(frozen=True)
class SwarmSettings:
    """How the swarm moves; the defaults are those of the standard swarm, see the module.

    Attributes:
        n_particles: Particles.
        n_generations: Evaluations of each particle, the random start included.
        constriction: Factor chi on the velocity.
        own_pull, near_pull: phi_own and phi_near.
        n_neighbours: Neighbours on each side of the ring that a particle listens to; 0 means the whole swarm.
    """

    n_particles: int = 160
    n_generations: int = 40
    constriction: float = 0.72984
    own_pull: float = 2.05
    near_pull: float = 2.05
    n_neighbours: int = 1

    def __post_init__(self) -> None:
        """Check.

        Raises:
            InvalidInputError: If a count is below one or a coefficient negative.
        """
        if self.n_particles < 1 or self.n_generations < 1 or self.n_neighbours < 0:
            raise InvalidInputError(
                f"a swarm of {self.n_particles} particles, {self.n_generations} generations and "
                f"{self.n_neighbours} neighbours cannot move: give at least 1, 1 and 0"
            )
        if min(self.constriction, self.own_pull, self.near_pull) < 0.0:
            raise InvalidInputError("the swarm's constriction and pulls must not be negative: see SwarmSettings")


@dataclass(frozen=True, eq=False)
class SwarmResult:
    """Where the swarm ended.

    Attributes:
        position: The best place that any particle has seen, (dimensions,).
        value: The function there.
        history: Best value after each generation, (generations,).
        n_evaluations: Positions that were evaluated.
    """

    position: FloatArray
    value: float
    history: FloatArray
    n_evaluations: int


def minimise(
    objective: Objective,
    lower: FloatArray,
    upper: FloatArray,
    rng: np.random.Generator,
    settings: SwarmSettings | None = None,
    *,
    first: FloatArray | None = None,
) -> SwarmResult:
    """Minimise ``objective`` between ``lower`` and ``upper`` (dimensions,).

    Args:
        objective: See `Objective`; called once a generation with all particles.
        lower, upper: The box; a dimension without range keeps its value.
        rng: Source of all randomness.
        settings: How the swarm moves.
        first: Places (n, dimensions) that the first particles start from instead of random ones.

    Raises:
        InvalidInputError: If the box is empty or not finite, a given place lies outside it, or the function returns
            not-a-number or the wrong shape.
    """
    setup = settings or SwarmSettings()
    low, high = _checked_box(lower, upper)
    n = setup.n_particles
    x = low + (high - low) * rng.random((n, len(low)))
    if first is not None:
        places = np.asarray(first, float).reshape(-1, len(low))[:n]
        if (places < low).any() or (places > high).any():
            raise InvalidInputError("a place that the swarm is to start from lies outside its box: move it inside")
        x[: len(places)] = places
    v = np.zeros_like(x)
    ring = _neighbours(n, setup.n_neighbours)
    own, best = x.copy(), np.full(n, np.inf)
    history = np.empty(setup.n_generations)
    for generation in range(setup.n_generations):
        if generation:
            near = own[ring[np.arange(n), np.argmin(best[ring], axis=1)]]
            drawn = setup.own_pull * rng.random(x.shape) * (own - x) + setup.near_pull * rng.random(x.shape) * (
                near - x
            )
            v = setup.constriction * (v + drawn)
            x, v = _mirrored(x + v, v, low, high)
        values = np.asarray(objective(x, best.copy()), float)
        if values.shape != (n,) or np.isnan(values).any():
            raise InvalidInputError(
                f"the swarm's function returned shape {values.shape} with {int(np.isnan(values).sum())} not-a-number "
                f"for {n} positions: return one number a position"
            )
        better = values < best
        own[better], best[better] = x[better], values[better]
        history[generation] = best.min()
    winner = int(np.argmin(best))
    return SwarmResult(own[winner].copy(), float(best[winner]), history, n * setup.n_generations)


def _checked_box(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    low, high = np.array(lower, float), np.array(upper, float)
    if low.ndim != 1 or low.shape != high.shape or not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise InvalidInputError(
            f"the swarm's box has corners of shapes {low.shape} and {high.shape}: give finite ones of one length"
        )
    if (low > high).any():
        worst = int(np.argmax(low - high))
        raise InvalidInputError(
            f"the swarm's box is empty: dimension {worst} ranges from {low[worst]:.6g} to {high[worst]:.6g}"
        )
    return low, high


def _neighbours(n: int, each_side: int) -> IntArray:
    """Return the particles that each one listens to, itself first, (n, listened)."""
    everyone = np.arange(n)
    if each_side == 0 or 2 * each_side + 1 >= n:
        return np.tile(everyone, (n, 1))
    offsets = [0, *(side * step for step in range(1, each_side + 1) for side in (-1, 1))]
    return np.asarray((everyone[:, None] + np.array(offsets)) % n)


def _mirrored(x: FloatArray, v: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Reflect positions at the faces of the box; whoever touched one stops in that dimension."""
    outside = (x < low) | (x > high)
    inside = np.where(x < low, 2.0 * low - x, np.where(x > high, 2.0 * high - x, x))
    # a step longer than the box would leave it on the other side
    return np.clip(inside, low, high), np.where(outside, 0.0, v)
