from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError
from cellwright.solvers.particle_swarm import Objective, SwarmSettings, minimise


def bowl(centre: FloatArray) -> Objective:
    return lambda x, _: ((x - centre) ** 2).sum(axis=1)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), dimensions=st.integers(1, 5), neighbours=st.integers(0, 2))
def test_every_position_stays_in_the_box_and_the_best_value_never_rises(
    seed: int, dimensions: int, neighbours: int
) -> None:
    rng = generator(seed)
    low = rng.uniform(-3.0, 0.0, dimensions)
    high = low + rng.uniform(0.0, 3.0, dimensions)
    seen: list[FloatArray] = []

    def rough(x: FloatArray, _: FloatArray) -> FloatArray:
        seen.append(x.copy())
        return np.asarray(np.sin(7.0 * x).sum(axis=1) + (x * x).sum(axis=1))

    result = minimise(rough, low, high, rng, SwarmSettings(12, 15, n_neighbours=neighbours))
    visited = np.concatenate(seen)
    assert (visited >= low).all() and (visited <= high).all()
    assert (np.diff(result.history) <= 0.0).all()
    values = np.sin(7.0 * visited).sum(axis=1) + (visited * visited).sum(axis=1)
    assert result.value == values.min() == result.history[-1]
    assert result.n_evaluations == len(visited)


@pytest.mark.parametrize("neighbours", [0, 1])
def test_the_bottom_of_a_bowl_is_found(neighbours: int) -> None:
    centre = np.array([0.3, -1.2, 2.0, 0.9])
    result = minimise(
        bowl(centre), -3.0 * np.ones(4), 3.0 * np.ones(4), generator(), SwarmSettings(n_neighbours=neighbours)
    )
    assert np.abs(result.position - centre).max() < (1e-2 if neighbours == 0 else 5e-2)


def test_the_minimum_on_a_face_of_the_box_is_found() -> None:
    result = minimise(lambda x, _: x.sum(axis=1), np.zeros(3), np.ones(3), generator())
    assert result.value < 1e-3


def test_the_same_generator_gives_the_same_result_to_the_last_bit() -> None:
    one, other = (minimise(bowl(np.ones(3)), -np.ones(3) * 4, np.ones(3) * 4, generator(7)) for _ in range(2))
    assert one.position.tobytes() == other.position.tobytes()
    assert one.history.tobytes() == other.history.tobytes()


def test_a_function_that_stops_early_where_a_particle_cannot_improve_changes_nothing() -> None:
    def whole(x: FloatArray, _: FloatArray) -> FloatArray:
        return np.asarray(np.cos(5.0 * x).sum(axis=1) + (x * x).sum(axis=1))

    def stopping(x: FloatArray, to_beat: FloatArray) -> FloatArray:
        values = whole(x, to_beat)
        return np.where(values < to_beat, values, 1e9)

    box = -2.0 * np.ones(3), 2.0 * np.ones(3)
    one, other = (minimise(each, *box, generator(3)) for each in (whole, stopping))
    assert one.position.tobytes() == other.position.tobytes()


def test_given_places_are_where_the_swarm_starts() -> None:
    centre = np.array([0.123, 0.456])
    result = minimise(bowl(centre), np.zeros(2), np.ones(2), generator(), SwarmSettings(5, 1), first=centre)
    assert result.value == 0.0


def test_infinite_values_are_never_preferred() -> None:
    def walled(x: FloatArray, _: FloatArray) -> FloatArray:
        return np.where(x[:, 0] < 0.5, np.inf, x[:, 0])

    result = minimise(walled, np.zeros(2), np.ones(2), generator())
    assert 0.5 <= result.value < 0.51


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        ([0.0, 2.0], [1.0, 1.0], "dimension 1 ranges from 2 to 1"),
        ([0.0], [1.0, 2.0], "of one length"),
        ([np.nan], [1.0], "finite"),
    ],
)
def test_a_box_that_is_none_is_told(low: list[float], high: list[float], said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        minimise(bowl(np.zeros(1)), np.array(low), np.array(high), generator())


def test_faulty_functions_settings_and_places_are_told() -> None:
    box = np.zeros(2), np.ones(2)
    with pytest.raises(InvalidInputError, match="160 not-a-number"):
        minimise(lambda x, _: np.full(len(x), np.nan), *box, generator())
    with pytest.raises(InvalidInputError, match=r"returned shape \(160, 1\)"):
        minimise(lambda x, _: x[:, :1], *box, generator())
    with pytest.raises(InvalidInputError, match="cannot move"):
        SwarmSettings(0)
    with pytest.raises(InvalidInputError, match="must not be negative"):
        SwarmSettings(own_pull=-1.0)
    with pytest.raises(InvalidInputError, match="outside its box"):
        minimise(bowl(np.zeros(2)), *box, generator(), first=np.array([[2.0, 0.0]]))
