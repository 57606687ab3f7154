from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwright.cell.bodies import BASE, WORLD, Body, Box
from cellwright.cell.ignored_pairs import IgnoredPairs, Reason, ignored_pairs
from cellwright.cell.scene import Scene
from tests.cellwright.cell.cells import at, scanning_cell

CELL = replace(scanning_cell(), ignored_pairs=np.empty((0, 2), np.int32))
NAMES = [body.name for body in CELL.bodies]


def reasons(found: IgnoredPairs) -> dict[frozenset[str], Reason]:
    return {
        frozenset((NAMES[a], NAMES[b])): Reason(int(code)) for (a, b), code in zip(found.pairs.tolist(), found.reason)
    }


def test_every_reason_is_found() -> None:
    pairs = reasons(ignored_pairs(CELL, range(7), np.random.default_rng(0), declared=[(11, 6)]))
    assert pairs[frozenset(("housing", "handle"))] == Reason.SAME_PARENT
    assert pairs[frozenset(("table", "post"))] == Reason.SAME_PARENT
    assert pairs[frozenset(("forearm_link", "wrist_1_link"))] == Reason.NEIGHBOURS
    assert pairs[frozenset(("wrist_1_link", "handle"))] == Reason.NEVER_TOUCHING
    assert pairs[frozenset((NAMES[11], NAMES[6]))] == Reason.DECLARED
    assert frozenset(("forearm_link", "housing")) not in pairs
    assert frozenset(("base_link_inertia", "upper_arm_link")) not in pairs
    assert frozenset(("upper_arm_link", "table")) not in pairs


def test_bodies_modelled_into_each_other_always_touch() -> None:
    bodies = (*CELL.bodies, Body("skirt", Box((0.3, 0.3, 0.2)), BASE, at(0, 0, 0.05)))
    found = ignored_pairs(replace(CELL, bodies=bodies), range(7), np.random.default_rng(0))
    rows = {tuple(pair): code for pair, code in zip(found.pairs.tolist(), found.reason.tolist())}
    assert rows[1, len(bodies) - 1] == Reason.ALWAYS_TOUCHING


def test_what_the_base_stands_in_is_not_looked_at() -> None:
    bodies = (*CELL.bodies, Body("plinth", Box((0.3, 0.3, 0.2)), WORLD, at(0, 0, -0.05)))
    found = ignored_pairs(replace(CELL, bodies=bodies), range(7), np.random.default_rng(0))
    assert [0, len(bodies) - 1] not in found.pairs.tolist()
    assert Scene(replace(CELL, bodies=bodies, ignored_pairs=found.pairs)).colliding_pair(CELL.start) is None


def test_the_tool_is_checked_against_the_link_before_it() -> None:
    bodies = (*CELL.bodies[:7], Body("bracket", Box((0.05, 0.05, 0.5)), 6, at(0.1, 0, -0.1)))
    found = ignored_pairs(replace(CELL, bodies=bodies), range(7), np.random.default_rng(0))
    assert [5, 7] not in found.pairs.tolist()


def test_pairs_that_are_left_out_do_not_collide_elsewhere() -> None:
    found = ignored_pairs(CELL, range(7), np.random.default_rng(0))
    never = {tuple(pair) for pair, code in zip(found.pairs.tolist(), found.reason) if code == Reason.NEVER_TOUCHING}
    assert never
    scene = Scene(CELL)
    for q in np.random.default_rng(99).uniform(CELL.robot.chain.lower, CELL.robot.chain.upper, (3000, 6)):
        assert not never & {(min(pair), max(pair)) for pair in scene.colliding_pairs(q)}


def test_the_same_seed_gives_the_same_pairs() -> None:
    first, second = (ignored_pairs(CELL, range(7), np.random.default_rng(3)) for _ in range(2))
    assert first.pairs.tobytes() == second.pairs.tobytes()
    assert first.reason.tobytes() == second.reason.tobytes()
