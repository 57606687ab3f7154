"""Overlaps as findings: the bodies, how deep, in words; what the cell permits is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.cell.ignored_pairs import Reason
from cellwright.cell.transforms import pose
from schemas.overlaps import StandingOverlaps
from schemas.poses import Pose
from schemas.sources import CellModel
from tasks.find_overlaps import OverlapParams, find_overlaps
from tests.cellwright.solvers import scanning_cell
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.scanning_artefacts import cell_model, part_mesh

TABLE_TOP = -0.005


def found(height: float, model: CellModel | None = None) -> StandingOverlaps:
    place = np.array([*scanning_cell.PART_AT[:2], height])
    params = OverlapParams(T_world_part=Pose.of(pose(place, np.eye(3))))
    return find_overlaps(model or cell_model(), part_mesh(), params=params)


def test_a_part_on_or_above_its_table_is_no_finding() -> None:
    for height in (TABLE_TOP, 0.0, TABLE_TOP - 9e-4):
        overlaps = found(height)
        assert overlaps.body == overlaps.finding == ()
        # part and table with each other and with the base
        assert overlaps.n_pairs == 3


def test_a_part_sunk_into_its_table_is_told_with_both_names_and_how_deep() -> None:
    overlaps = found(TABLE_TOP - 0.012)
    assert overlaps.body == ("part",)
    assert overlaps.other == ("table",)
    assert overlaps.depth_m == pytest.approx([0.012])
    assert overlaps.finding == (
        "part and table stand in one another, by at least 12.0 mm: move one of them or correct its size",
    )
    assert "FCL" in overlaps.engine


def test_a_pair_that_the_cell_permits_is_left_out() -> None:
    model = cell_model()
    table = model.body.index("table")
    pairs = np.array([[table, len(model.body)]], np.int32)
    for reason, count in ((Reason.DECLARED, 0), (Reason.SAME_PARENT, 1)):
        permitted = replace(
            model,
            ignored_pair=np.concatenate([model.ignored_pair, pairs]),
            ignored_reason=np.append(model.ignored_reason, np.int8(reason)).astype(np.int8),
        )
        assert len(found(TABLE_TOP - 0.012, permitted).body) == count


def test_the_result_is_the_one_of_this_version() -> None:
    # the engine's name holds its version, and the depth its last digits
    check_golden(find_overlaps, rounded(found(TABLE_TOP - 0.012), 6, engine=""))
