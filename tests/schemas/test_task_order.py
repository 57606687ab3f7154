from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError
from schemas.task_order import order_faults, task_order

PAIRS = st.sets(st.tuples(st.integers(0, 4), st.integers(0, 4)).filter(lambda pair: pair[0] != pair[1]), max_size=8)


@given(PAIRS)
def test_a_contradiction_is_found_exactly_if_no_order_respects_all(pairs: set[tuple[int, int]]) -> None:
    tasks = [(str(row), [str(i) for i, j in sorted(pairs) if j == row]) for row in range(5)]
    possible = any(all(order.index(i) < order.index(j) for i, j in pairs) for order in itertools.permutations(range(5)))
    assert (not order_faults(tasks)) == possible
    if possible:
        assert set(task_order(tasks)) == pairs
    else:
        with pytest.raises(InvalidInputError, match="contradicts itself"):
            task_order(tasks)


@given(PAIRS)
def test_the_words_of_a_contradiction_name_a_true_loop(pairs: set[tuple[int, int]]) -> None:
    tasks = [(str(row), [str(i) for i, j in sorted(pairs) if j == row]) for row in range(5)]
    for _, _, words in order_faults(tasks):
        loop = [int(name.strip("'")) for name in words.split(": ")[1].split(" after ")]
        assert loop[0] == loop[-1] and len(loop) > 2
        assert all((earlier, later) in pairs for later, earlier in itertools.pairwise(loop))
