"""Set-cover instances for tests: random ones with brute force, strips on an unrolled cylinder, benchmark files."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

from cellwright.arrays import BoolArray, FloatArray, IntArray

COVER_DATA = Path(__file__).parents[3].parent / "shared" / "data" / "cover"


@st.composite
def small_problems(draw: st.DrawFn, max_rows: int = 7, max_columns: int = 9) -> tuple[BoolArray, FloatArray]:
    """A dense zero-one matrix whose rows can all be covered, with costs 1 to 3 (often all 1)."""
    n_rows, n_columns = draw(st.integers(1, max_rows)), draw(st.integers(1, max_columns))
    bits = draw(st.lists(st.booleans(), min_size=n_rows * n_columns, max_size=n_rows * n_columns))
    matrix = np.array(bits, bool).reshape(n_rows, n_columns)
    for row in np.flatnonzero(~matrix.any(axis=1)):
        matrix[row, draw(st.integers(0, n_columns - 1))] = True
    if draw(st.booleans()):
        return matrix, np.ones(n_columns)
    return matrix, np.array(draw(st.lists(st.integers(1, 3), min_size=n_columns, max_size=n_columns)), float)


def cheapest(matrix: BoolArray, costs: FloatArray, n_needed: int | None = None) -> float:
    """The cost of a cheapest cover of ``n_needed`` rows (all), by trying every set of columns."""
    needed = matrix.shape[0] if n_needed is None else n_needed
    best = np.inf
    for size in range(matrix.shape[1] + 1):
        for chosen in itertools.combinations(range(matrix.shape[1]), size):
            if matrix[:, list(chosen)].any(axis=1).sum() >= needed:
                best = min(best, float(costs[list(chosen)].sum()))
    return best


def strips_on_cylinder(n_samples: int, n_views: int, seed: int = 0) -> BoolArray:
    """Samples on an unrolled cylinder against strips 100 mm wide in random directions, as sweeps measure them."""
    rng = np.random.default_rng(seed)
    radius, height = 0.06, 0.2
    sample = np.stack([rng.uniform(0, 2 * np.pi, n_samples), rng.uniform(0, height, n_samples)], axis=1)
    centre = sample[rng.integers(0, n_samples, n_views)]
    turn = rng.uniform(0, np.pi, n_views)
    angle = (sample[:, None, 0] - centre[None, :, 0] + np.pi) % (2 * np.pi) - np.pi
    across, up = radius * np.sin(angle), sample[:, None, 1] - centre[None, :, 1]
    along = across * np.cos(turn) + up * np.sin(turn)
    aside = -across * np.sin(turn) + up * np.cos(turn)
    seen = (np.abs(angle) < np.radians(55)) & (np.abs(aside) < 0.03) & (np.abs(along) < 0.06)
    return np.asarray(seen[seen.any(axis=1)])


def rail_problem(name: str) -> tuple[tuple[IntArray, IntArray, int], FloatArray]:
    """A crew-scheduling instance of the OR-Library (Beasley) as column starts, rows, number of rows, and costs."""
    path = COVER_DATA / name
    if not path.exists():
        pytest.skip(f"{path} is not there: the public test data lie beside the project")
    lines = path.read_text().splitlines()
    n_rows, n_columns = (int(word) for word in lines[0].split())
    columns = [[int(word) for word in line.split()] for line in lines[1 : n_columns + 1]]
    starts = np.cumsum([0] + [column[1] for column in columns])
    rows = np.array([row for column in columns for row in column[2:]]) - 1
    return (starts, rows, n_rows), np.array([column[0] for column in columns], float)
