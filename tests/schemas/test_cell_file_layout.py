from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from schemas.cell_file import CellFile, load_cell_file
from schemas.cell_file_layout import carried_bodies, layout_harness
from tests.small_inspection import CELL, write_cell

PLANAR = "layout: {harness: {planar: {x: [-100 mm, 100 mm], yaw: [-90 deg, 90 deg]}}}\n"


def read(folder: Path, text: str, *overrides: str) -> CellFile:
    return load_cell_file(write_cell(folder, CELL + text), overrides)


def refusal(folder: Path, text: str, *overrides: str) -> str:
    with pytest.raises(InvalidInputError) as caught:
        read(folder, text, *overrides)
    return str(caught.value)


def test_without_the_key_nothing_moves(tmp_path: Path) -> None:
    cell = read(tmp_path, "")
    assert cell.layout is None and carried_bodies(cell) == ()


def test_the_body_that_the_part_rests_on_is_carried(tmp_path: Path) -> None:
    assert carried_bodies(read(tmp_path, PLANAR)) == ("table",)
    assert carried_bodies(read(tmp_path, PLANAR, "layout.carries=[]")) == ()
    assert carried_bodies(read(tmp_path, PLANAR, "layout.move=robot")) == ()


def test_a_turn_goes_about_the_parts_position(tmp_path: Path) -> None:
    harness = layout_harness(read(tmp_path, PLANAR))
    np.testing.assert_allclose(harness.poses(np.zeros(2)), np.eye(4), atol=1e-15)
    turned = harness.poses(np.array([0.0, np.pi / 2]))
    np.testing.assert_allclose(turned @ [0.7, 0.0, 0.1, 1.0], [0.7, 0.0, 0.1, 1.0], atol=1e-15)
    shifted = harness.poses(np.array([0.05, 0.0]))
    np.testing.assert_allclose(shifted[:3, 3], [0.05, 0.0, 0.0], atol=1e-15)


def test_nothing_moves_at_zero_whatever_the_offsets(tmp_path: Path) -> None:
    text = (
        "layout:\n  harness:\n    joints:\n"
        "      - {offset: {position: [-500 mm, 0 mm, 0 mm], rotation: [0 deg, 0 deg, 30 deg]}}\n"
        "      - {turn: z, range: [-30 deg, 30 deg]}\n"
        "      - {offset: {position: [500 mm, 0 mm, 0 mm]}}\n"
    )
    harness = layout_harness(read(tmp_path, text))
    np.testing.assert_allclose(harness.poses(np.zeros(1)), np.eye(4), atol=1e-15)
    axis = np.array([0.2, 0.0, 0.0, 1.0])  # half a metre before the part
    np.testing.assert_allclose(harness.poses(np.array([0.5])) @ axis, axis, atol=1e-15)


def test_the_robots_harness_stands_at_its_base(tmp_path: Path) -> None:
    base = "robot.base.position=[100 mm, 0 mm, 0 mm]"
    harness = layout_harness(read(tmp_path, PLANAR, "layout.move=robot", base))
    turned = harness.poses(np.array([0.0, 1.0]))
    np.testing.assert_allclose(turned @ [0.1, 0.0, 0.0, 1.0], [0.1, 0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "overrides", "message"),
    [
        (
            PLANAR,
            ("layout.carries=[tabel]",),
            "layout.carries.0: 'tabel' is no body of the cell: did you mean table?",
        ),
        (
            PLANAR,
            ("layout.harness.planar.x=[50 mm, 100 mm]",),
            "layout.harness.planar.x: leaves zero out, which is where it stands now: let the range hold it",
        ),
        (
            "layout: {harness: {joints: [{slide: x, range: [-2 mm, -1 mm]}]}}\n",
            (),
            "layout.harness.joints.0.range: leaves zero out, which is where it stands now: let the range hold it",
        ),
        (
            PLANAR,
            ("layout.harness.planar.x=[100 mm, -100 mm]",),
            "layout.harness.planar.x: is reversed, from 100 mm to -100 mm, its lower end 200 mm above",
        ),
        (
            PLANAR,
            ("layout.move=robot", "layout.carries=[table]"),
            "layout.carries: is given, but the robot is moved: remove it, or write move: part",
        ),
        (
            PLANAR,
            ("part.rests_on=null", "part.pose.position=[700 mm, 0 mm, 200 mm]"),
            "layout: moves a part that rests on nothing: say part.rests_on, name in carries what moves along with it, "
            "or write carries: [] to move it alone",
        ),
        ("layout: {move: part}\n", (), "layout.harness: is missing: add it, like `harness: {planar: {x: ["),
        (PLANAR, ("layout.move=table",), "layout.move: 'table' is not one of part, robot"),
        (PLANAR, ("layout.evaluation=5",), "layout.evaluation: unknown key 'evaluation': did you mean evaluations?"),
    ],
)
def test_what_does_not_go_together_is_one_clear_error(
    tmp_path: Path, text: str, overrides: tuple[str, ...], message: str
) -> None:
    told = refusal(tmp_path, text, *overrides)
    assert message in told and "\n" not in told
