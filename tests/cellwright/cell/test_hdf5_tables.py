from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwright.cell.hdf5_tables import read_dataset
from cellwright.cell.task_tables import read_task_table
from cellwright.errors import InvalidInputError

PUBLIC = Path(__file__).parents[4] / "shared" / "data" / "sequencing" / "robotsp-245-targets.hdf5"
needs_public = pytest.mark.skipif(not PUBLIC.is_file(), reason="the public drilling targets are not beside the project")


@needs_public
def test_the_public_targets_are_read_as_they_were_published() -> None:
    targets = read_dataset(PUBLIC.name, PUBLIC.read_bytes(), "targets")
    assert targets.shape == (245, 6)
    assert np.allclose(targets[0], [0.57, 0.225, 0.37, 1.0, 0.0, 0.0])
    assert np.allclose(np.linalg.norm(targets[:, 3:], axis=1), 1.0)
    assert len(np.unique(targets[:, :3], axis=0)) == 245


@needs_public
def test_datasets_in_groups_are_read_by_their_path() -> None:
    content = PUBLIC.read_bytes()
    assert read_dataset(PUBLIC.name, content, "others/number_of_targets").tolist() == [25, 50, 100, 150, 200, 245]
    assert read_dataset(PUBLIC.name, content, "others/cpu_time").shape == (5, 6)


@needs_public
def test_targets_become_tasks_in_metres() -> None:
    rows = read_task_table(PUBLIC.name, PUBLIC.read_bytes())
    assert len(rows) == 245 and rows[0].name == "1" and rows[-1].name == "245"
    assert rows[0].position(1e-3) == pytest.approx((0.57, 0.225, 0.37))


@needs_public
@given(st.data())
def test_a_damaged_file_is_refused_or_read_but_never_a_crash(data: st.DataObject) -> None:
    content = bytearray(PUBLIC.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(8, 4000))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(100, len(content)))
    try:
        found = read_dataset("damaged.hdf5", bytes(content[:cut]), "targets")
    except InvalidInputError as error:
        assert str(error).endswith("save its targets as CSV (x,y,z,dx,dy,dz)")
    else:
        assert found.dtype == np.float64


@needs_public
def test_a_dataset_that_is_not_there_is_named() -> None:
    with pytest.raises(InvalidInputError, match="has no dataset 'holes'"):
        read_dataset(PUBLIC.name, PUBLIC.read_bytes(), "holes")


def test_another_file_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="is no HDF5 file"):
        read_dataset("x.hdf5", b"hello", "targets")
