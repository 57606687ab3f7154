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
TABLE_EDGE = 1.4
"""Where the table of the cell ends along x, m."""
RADIUS = scanning_cell.RADIUS


def found(height: float, model: CellModel | None = None, xy: tuple[float, float] = (0.7, 0.0)) -> StandingOverlaps:
    place = np.array([*xy, height])
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


def test_a_part_on_its_table_is_carried_by_it_and_is_no_note() -> None:
    stands = found(TABLE_TOP)
    assert (stands.supported_by, stands.tipping, stands.note, stands.attention) == (("table",), (), (), ())
    assert stands.support_margin_m == pytest.approx(RADIUS, rel=0.1)
    assert stands.overhang_m == 0.0


def test_a_part_that_reaches_over_the_edge_is_a_note_and_one_that_would_tip_a_finding() -> None:
    half = found(TABLE_TOP, xy=(TABLE_EDGE - 0.01, 0.0))
    assert half.attention == ()
    assert half.note == (
        f"the part reaches {1e3 * (RADIUS - 0.01):.1f} mm beyond table; its centre of mass is supported, "
        "10.0 mm from the edge",
    )
    tips = found(TABLE_TOP, xy=(TABLE_EDGE + 0.01, 0.0))
    assert tips.attention == tips.tipping
    assert tips.tipping == (
        "the part would tip: its centre of mass lies 10.0 mm outside of where it stands on table: "
        "move it, or model what holds it",
    )
    assert tips.note == ()
    assert (tips.support_margin_m, tips.overhang_m) == (pytest.approx(-0.01), pytest.approx(RADIUS + 0.01))


def test_a_part_in_the_air_is_a_note_with_the_distance() -> None:
    stands = found(TABLE_TOP + 0.012)
    assert (stands.supported_by, stands.tipping, stands.support_margin_m) == ((), (), np.inf)
    assert stands.note == ("the part touches nothing: it hangs in the air, 12.0 mm from table; let it rest on a body",)


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
