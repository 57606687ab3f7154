"""Which pairs of bodies need no collision check, and why: computed once for a cell and stored with it.

As MoveIt's set-up assistant does it: neighbouring links touch at their joint by design, pairs of the arm that collide
in every one of many random configurations are modelled into each other, and pairs of the arm that never come within
a margin cannot meet. Of the world nothing is left out: an obstacle that the moving arm hits in every configuration is
in its way, and is told as such. Two bodies that stand still, be one the robot's base, are not checked in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import FloatArray, Int8Array, Int32Array
from cellwright.cell.bodies import WORLD
from cellwright.cell.cell import Cell

if TYPE_CHECKING:
    from cellwright.cell.scene import Scene

N_SAMPLES = 5000
NEVER_MARGIN = 0.03
"""A pair that no sampled configuration brings within this distance (m) counts as never touching.

Samples are sparse in six dimensions, so a pair may come closer between them than at them; pairs that pass each
other closely are kept by this margin.
"""


class Reason(IntEnum):
    """Why a pair is not checked."""

    SAME_PARENT = 0
    NEIGHBOURS = 1
    ALWAYS_TOUCHING = 2
    NEVER_TOUCHING = 3
    DECLARED = 4


@dataclass(frozen=True, eq=False)
class IgnoredPairs:
    """Pairs of rows of the bodies, lower row first, sorted, (pairs, 2), and the reason of each, (pairs,)."""

    pairs: Int32Array
    reason: Int8Array


def ignored_pairs(
    cell: Cell,
    links: Collection[int],
    generator: np.random.Generator,
    *,
    declared: Collection[tuple[int, int]] = (),
    n_samples: int = N_SAMPLES,
    progress: Callable[[float], None] | None = None,
) -> IgnoredPairs:
    """Compute the pairs that need no check; the cell's own ``ignored_pairs`` are not looked at.

    Args:
        cell: The cell without part.
        links: Rows of the bodies that are the arm's own links: only these are neighbours of each other. The
            tool's bodies are checked against all links but the one that they are on.
        generator: Source of the random configurations.
        declared: Pairs that somebody states as harmless.
        n_samples: Random configurations; 0 for those pairs alone that are known without trying.
        progress: Called with the share done.
    """
    parents = [body.parent for body in cell.bodies]
    n = len(parents)
    found: dict[tuple[int, int], Reason] = {}
    for a in range(n):
        for b in range(a + 1, n):
            if parents[a] == parents[b]:
                found[a, b] = Reason.SAME_PARENT
            elif (
                a in links
                and b in links
                and WORLD not in (parents[a], parents[b])
                and abs(parents[a] - parents[b]) == 1
            ):
                found[a, b] = Reason.NEIGHBOURS
    for one, other in declared:
        found.setdefault((min(one, other), max(one, other)), Reason.DECLARED)
    if n_samples:
        found |= _sampled(cell, found, generator, n_samples, progress or (lambda share: None))
    pairs = sorted(found)
    reasons = np.array([found[pair] for pair in pairs], np.int8)
    return IgnoredPairs(np.array(pairs, np.int32).reshape(-1, 2), reasons)


def _sampled(
    cell: Cell,
    known: Collection[tuple[int, int]],
    generator: np.random.Generator,
    n_samples: int,
    tell: Callable[[float], None],
) -> dict[tuple[int, int], Reason]:
    from cellwright.cell.scene import Scene  # brings a compiler, which those who read the reasons need not wait for

    parents = np.array([body.parent for body in cell.bodies])
    skip = np.array(list(known), np.int32).reshape(-1, 2)
    bare = Cell(cell.robot, cell.bodies, skip, cell.T_world_base, cell.T_flange_scanner, cell.start)
    chain = cell.robot.chain
    samples = generator.uniform(chain.lower, chain.upper, (n_samples, cell.robot.n_joints))
    samples[0] = cell.start
    touching, near = Scene(bare), Scene(bare, NEVER_MARGIN)
    always = _counts(touching, samples[: max(1, n_samples // 10)], lambda share: tell(0.1 * share))
    within = _counts(near, samples, lambda share: tell(0.1 + 0.9 * share))
    found: dict[tuple[int, int], Reason] = {}
    for a, b in touching.pairs.tolist():
        pair = (min(a, b), max(a, b))
        if WORLD in (parents[a], parents[b]):
            continue
        if always.get(pair, 0) == max(1, n_samples // 10):
            found[pair] = Reason.ALWAYS_TOUCHING
        elif within.get(pair, 0) == 0:
            found[pair] = Reason.NEVER_TOUCHING
    return found


def _counts(scene: Scene, samples: FloatArray, tell: Callable[[float], None]) -> dict[tuple[int, int], int]:
    counts: dict[tuple[int, int], int] = {}
    for number, q in enumerate(samples):
        if number % 100 == 0:
            tell(number / len(samples))
        for a, b in scene.colliding_pairs(q):
            pair = (min(a, b), max(a, b))
            counts[pair] = counts.get(pair, 0) + 1
    return counts
