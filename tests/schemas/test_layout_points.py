"""Tool poses are read from tables of points; a row that is none is named by its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from schemas.layout_points import read_points

DOWN = (np.pi, 0.0, 0.0)


def written(folder: Path, text: str) -> Path:
    path = folder / "way.csv"
    path.write_text(text)
    return path


def test_positions_take_the_rotation_that_is_given(tmp_path: Path) -> None:
    poses = read_points(written(tmp_path, "# mm\nx;y;z\n1;2;3\n4, 5, 6\n"), "mm", DOWN)
    np.testing.assert_allclose(poses[:, :3, 3], [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006]])
    np.testing.assert_allclose(poses[0, :3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_quaternions_go_before_it(tmp_path: Path) -> None:
    [pose] = read_points(written(tmp_path, "0 0 1 1 0 0 0\n"), "m", DOWN)
    np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n", "line 1: '1 2' is not 3 or 7 numbers"),
        ("1 2 3\n1 two 3\n", "line 2: '1 two 3' is not 3 or 7 numbers"),
        ("1 2 nan\n", "line 1"),
        ("nan 2 3\n1 2 3\n", "line 1: 'nan 2 3' is not 3 or 7 numbers"),
        ("0 0 0 1 1 0 0\n", "a quaternion of length 1.41421: scale it to 1"),
        ("# nothing\n", "has no row of numbers"),
        ("1 2 3\n" * 2001, "has more than 2000 rows"),
    ],
)
def test_what_is_no_pose_is_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read_points(written(tmp_path, text), "mm", DOWN)
