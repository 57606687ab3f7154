from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.gtsplib import format_gtsplib, parse_gtsplib, read_gtsplib
from cellwright.solvers.gtsp.problem import SequencingProblem
from tests.cellwright.solvers.sequencing_problems import groups

PUBLIC = Path(__file__).parents[5] / "shared" / "data" / "gtsp"
needs_public = pytest.mark.skipif(not PUBLIC.is_dir(), reason="the public GTSPLIB files are not beside the project")

COST = np.array([[0, 1, 2, 3], [1, 0, 4, 5], [2, 4, 0, 6], [3, 5, 6, 0]])
HEAD = "NAME : tiny\nTYPE : {kind}\nDIMENSION : 4\nGTSP_SETS : 2\nEDGE_WEIGHT_TYPE : {weights}\n"
SETS = "GTSP_SET_SECTION\n1 1 3 -1\n2 2 4 -1\nEOF\n"


def explicit(shape, numbers, kind="GTSP"):
    return HEAD.format(kind=kind, weights="EXPLICIT") + (
        f"EDGE_WEIGHT_FORMAT : {shape}\nEDGE_WEIGHT_SECTION\n{numbers}\n{SETS}"
    )


def coordinates(weights, points):
    rows = "\n".join(f"{k + 1} {' '.join(map(str, point))}" for k, point in enumerate(points))
    return HEAD.format(kind="GTSP", weights=weights) + f"NODE_COORD_SECTION\n{rows}\n{SETS}"


@pytest.mark.parametrize(
    ("shape", "numbers"),
    [
        ("FULL_MATRIX", "0 1 2 3  1 0 4 5  2 4 0 6  3 5 6 0"),
        ("UPPER_ROW", "1 2 3 4 5 6"),
        ("UPPER_DIAG_ROW", "0 1 2 3 0 4 5 0 6 0"),
        ("LOWER_ROW", "1 2 4 3 5 6"),
        ("LOWER_DIAG_ROW", "0 1 0 2 4 0 3 5 6 0"),
        ("UPPER_COL", "1 2 4 3 5 6"),
        ("UPPER_DIAG_COL", "0 1 0 2 4 0 3 5 6 0"),
        ("LOWER_COL", "1 2 3 4 5 6"),
        ("LOWER_DIAG_COL", "0 1 2 3 0 4 5 0 6 0"),
    ],
)
def test_every_matrix_format_gives_the_same_costs(shape, numbers):
    problem = parse_gtsplib(explicit(shape, numbers))
    assert np.array_equal(problem.cost, COST)
    assert [own.tolist() for own in problem.clusters] == [[0, 2], [1, 3]]


@pytest.mark.parametrize(
    ("weights", "between"),
    [("EUC_2D", 7), ("CEIL_2D", 8), ("ATT", 3), ("MAN_2D", 10), ("MAX_2D", 5)],
)
def test_distances_are_those_of_tsplib(weights, between):
    problem = parse_gtsplib(coordinates(weights, [(0, 0), (5, 5), (1, 2), (9, 9)]))
    assert problem.cost[0, 1] == problem.cost[1, 0] == between
    assert not problem.cost.diagonal().any()


def test_geographical_distances_are_those_of_ulysses():
    # the first two cities of TSPLIB's ulysses16, 509 km apart in its published tables
    problem = parse_gtsplib(coordinates("GEO", [(38.24, 20.42), (39.57, 26.15), (40.56, 25.32), (36.26, 23.12)]))
    assert problem.cost[0, 1] == 509 and problem.cost[0, 2] == 501 and problem.cost[1, 2] == 126


@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
@settings(max_examples=30, deadline=None)
def test_what_is_written_reads_back_the_same(seed, symmetric, whole):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 4, rng.integers(2, 6))
    cost = rng.uniform(0, 1e4, (sizes.sum(),) * 2)
    cost = np.floor(cost) if whole else cost
    cost = cost + cost.T if symmetric else cost
    problem = SequencingProblem(cost, groups(sizes))
    again = parse_gtsplib(format_gtsplib(problem, "round trip", "a comment: with colon"))
    assert np.array_equal(again.cost, problem.cost)
    assert all(np.array_equal(a, b) for a, b in zip(again.clusters, problem.clusters))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_an_order_among_sets_and_missing_ways_read_back_the_same(seed):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 4, rng.integers(3, 7))
    cost = np.floor(rng.uniform(0, 1e4, (sizes.sum(),) * 2))
    n_first = sizes[0]
    cost[n_first:, n_first:][rng.uniform(size=(len(cost) - n_first,) * 2) < 0.2] = np.inf
    rank = rng.permutation(np.arange(1, len(sizes)))
    before = tuple((int(a), int(b)) for a, b in itertools.pairwise(rank) if rng.uniform() < 0.5)
    problem = SequencingProblem(cost, groups(sizes), start=0, before=before)
    again = parse_gtsplib(format_gtsplib(problem))
    owner = problem.cluster_of()
    between = owner[:, None] != owner[None, :]
    assert np.array_equal(again.cost[between], cost[between])
    assert again.start == 0 and again.closed and set(again.before) == set(before)


ORDERED = explicit("FULL_MATRIX", "0 1 2 3  1 0 4 5  -1 4 0 6  -1 9 6 0", "PCGLNS").replace("EOF\n", "")


def test_a_tour_with_an_order_among_its_sets_is_read():
    problem = parse_gtsplib(ORDERED + "GTSP_SET_ORDERING\n1 2 -1\nEOF\n")
    assert problem.before == ((0, 1),) and problem.start == 0
    assert problem.cost[2, 0] == np.inf and problem.cost[0, 2] == 2.0


def test_what_is_wrong_with_an_order_is_told():
    for order, message in (
        ("1 7 -1", r"line \d+: GTSP_SET_ORDERING has set 7, but GTSP_SETS is 2"),
        ("2 1 -1", "line 12: .*set 2 before set 1"),
        ("1 2", "ends within set 1"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            parse_gtsplib(f"{ORDERED}GTSP_SET_ORDERING\n{order}\nEOF\n")
    with pytest.raises(InvalidInputError, match="stands in a file of TYPE GTSP: write TYPE : PCGLNS"):
        parse_gtsplib(ORDERED.replace("TYPE : PCGLNS", "TYPE : GTSP") + "GTSP_SET_ORDERING\n1 2 -1\n")


def test_what_stands_within_clusters_is_not_written():
    """Nobody looks at it, but a reader would refuse what is negative."""
    cost = np.where(np.eye(4, dtype=bool), -1.0, COST.astype(float))
    cost[0, 1] = cost[1, 0] = -np.inf
    cost[2, 3] = np.nan
    problem = SequencingProblem(cost, ((0, 1), (2, 3)))
    again = parse_gtsplib(format_gtsplib(problem))
    assert np.array_equal(again.cost[:2, 2:], problem.cost[:2, 2:]) and not again.cost[:2, :2].any()


ASYMMETRIC = "0 1 2 3  1 0 4 5  2 4 0 6  3 9 6 0"


def test_an_asymmetric_matrix_is_read_as_such_but_refused_as_symmetric():
    assert parse_gtsplib(explicit("FULL_MATRIX", ASYMMETRIC, "AGTSP")).cost[3, 1] == 9
    with pytest.raises(InvalidInputError, match=r"TYPE is GTSP, but 2 to 4 costs 5 and 4 to 2 costs 9.*AGTSP"):
        parse_gtsplib(explicit("FULL_MATRIX", ASYMMETRIC))
    with pytest.raises(InvalidInputError, match="symmetric problem is asked for"):
        parse_gtsplib(explicit("FULL_MATRIX", ASYMMETRIC, "AGTSP"), symmetric=True)


GOOD = explicit("UPPER_ROW", "1 2 3\n4 5\n6")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("DIMENSION : 4", "DIMENSION : four", "line 3: DIMENSION is 'four'"),
        ("DIMENSION : 4\n", "", "DIMENSION is missing"),
        ("DIMENSION : 4", "DIMENSION : 5", "6 numbers, but UPPER_ROW of DIMENSION 5 has 10"),
        ("GTSP_SETS : 2", "GTSP_SETS : 0", "line 4: GTSP_SETS is '0'"),
        ("GTSP_SETS : 2", "GTSP_SETS : 3", "2 sets, but GTSP_SETS is 3"),
        ("TYPE : GTSP", "TYPE : TSP", "line 2: TYPE is 'TSP'"),
        ("TYPE : GTSP", "TYPE :", "line 2: TYPE is ''"),
        ("EXPLICIT", "XRAY1", "EDGE_WEIGHT_TYPE is 'XRAY1': give one of EXPLICIT"),
        ("UPPER_ROW", "UPPER", "EDGE_WEIGHT_FORMAT is 'UPPER'"),
        ("4 5\n", "4 five\n", "line 9: EDGE_WEIGHT_SECTION has 'five'"),
        ("4 5\n", "4 nan\n", "line 9: EDGE_WEIGHT_SECTION has 'nan'"),
        ("4 5\n", "4 -5\n", "line 9: EDGE_WEIGHT_SECTION has '-5'"),
        ("1 1 3 -1", "1 1 9 -1", "line 12: set 1 has node 9"),
        ("1 1 3 -1", "1 1 2 -1", "node 2 is in set 1 and in set 2"),
        ("1 1 3 -1", "1 1 -1", "node 3 is in no set"),
        ("1 1 3 -1", "1 -1", "set 1 has no nodes"),
        ("1 1 3 -1", "7 1 3 -1", "has set 7"),
        ("1 1 3 -1", "1 1.5 3 -1", "'1.5': give a whole number"),
        ("2 2 4 -1", "2 2 4", "ends within set 2"),
        ("NAME", "hello\nNAME", "line 1: 'hello' is neither"),
        ("GTSP_SETS : 2", "GTSP_SETS : 2\nGTSP_SETS : 2", "line 5: GTSP_SETS stands there a second time"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_with_its_line(old, new, message):
    assert old in GOOD
    with pytest.raises(InvalidInputError, match=message):
        parse_gtsplib(GOOD.replace(old, new, 1), "tiny.gtsp")


@pytest.mark.parametrize(("old", "new"), [("3 1 2", "2 1 2"), ("3 1 2", "9 1 2"), ("3 1 2", "3 1"), ("3 1 2", "3 1 x")])
def test_wrong_coordinates_are_told(old, new):
    good = coordinates("EUC_2D", [(0, 0), (5, 5), (1, 2), (9, 9)])
    with pytest.raises(InvalidInputError, match="NODE_COORD_SECTION"):
        parse_gtsplib(good.replace(old, new))


def test_a_file_that_is_none_is_told(tmp_path):
    with pytest.raises(InvalidInputError, match="cannot be read"):
        read_gtsplib(tmp_path / "none.gtsp")
    (tmp_path / "binary.gtsp").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InvalidInputError, match=r"is not text in UTF-8 .byte 0."):
        read_gtsplib(tmp_path / "binary.gtsp")


def test_what_the_format_cannot_hold_is_not_written():
    for fields, message in (({"closed": False}, "open"), ({"start": 1}, "start"), ({"service": np.ones(4)}, "service")):
        with pytest.raises(InvalidInputError, match=message):
            format_gtsplib(SequencingProblem(np.ones((4, 4)), ((0, 1), (2, 3)), **fields))


@needs_public
@pytest.mark.parametrize(("name", "n", "m"), [("39rat195", 39, 195), ("107si535", 107, 535)])
def test_public_files_are_read_whole(name, n, m):
    problem = read_gtsplib(PUBLIC / f"{name}.gtsp", symmetric=True)
    assert (problem.n_clusters, problem.n_alternatives) == (n, m)
    again = parse_gtsplib(format_gtsplib(problem))
    assert np.array_equal(again.cost, problem.cost)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("DIMENSION : 4", f"DIMENSION : {'9' * 5000}", "DIMENSION is '999"),
        ("1 1 2 -1", f"1 {'1' * 5000} 2 -1", "GTSP_SET_SECTION has '111"),
        ("9 9", "9 1e308", "EDGE_WEIGHT_SECTION has '1e308': give numbers of at least 0 and at most 1e"),
    ],
    ids=["dimension", "node", "weight"],
)
def test_numbers_that_nothing_can_count_with_are_refused(old, new, said):
    text = (
        "TYPE : AGTSP\nDIMENSION : 4\nGTSP_SETS : 2\nEDGE_WEIGHT_TYPE : EXPLICIT\nEDGE_WEIGHT_FORMAT : FULL_MATRIX\n"
        "EDGE_WEIGHT_SECTION\n0 0 9 9\n0 0 9 9\n9 9 0 0\n9 9 0 0\nGTSP_SET_SECTION\n1 1 2 -1\n2 3 4 -1\nEOF\n"
    )
    assert parse_gtsplib(text).n_clusters == 2
    with pytest.raises(InvalidInputError, match=re.escape(said)):
        parse_gtsplib(text.replace(old, new, 1))


def test_coordinates_whose_distances_overflow_are_refused():
    text = (
        "TYPE : GTSP\nDIMENSION : 2\nGTSP_SETS : 2\nEDGE_WEIGHT_TYPE : EUC_2D\nNODE_COORD_SECTION\n1 1e200 0\n2 0 0\n"
        "GTSP_SET_SECTION\n1 1 -1\n2 2 -1\nEOF\n"
    )
    with pytest.raises(InvalidInputError, match=r"line 6: NODE_COORD_SECTION has '1e200'"):
        parse_gtsplib(text)
