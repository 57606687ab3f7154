from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError, LakeError
from schemas.artefact import Artefact, digest
from schemas.columns import ANY_WIDTH, column, fact
from schemas.views import Measurability
from storage.parquet import decode, encode
from tests.storage.specimens import Specimen, Tally, TallyInDozens, same, specimens, tally


@given(specimens())
@settings(deadline=None)
def test_every_artefact_comes_back_bit_for_bit(specimen: Specimen) -> None:
    back = decode(Specimen, encode(specimen))
    assert same(back, specimen)
    assert digest(back) == digest(specimen)


@given(specimens())
@settings(deadline=None, max_examples=25)
def test_the_same_artefact_gives_the_same_bytes_on_any_number_of_threads(specimen: Specimen) -> None:
    once = encode(specimen)
    threads = pa.cpu_count()
    try:
        pa.set_cpu_count(1)
        assert encode(specimen) == once
    finally:
        pa.set_cpu_count(threads)
    assert encode(decode(Specimen, once)) == once  # type: ignore[arg-type]


def test_many_row_groups_come_back_as_one_array() -> None:
    n = 2_500_000
    view = np.arange(n, dtype=np.int32) // 100
    entries = Measurability(
        view=view,
        sample=np.arange(n, dtype=np.int32) % 850,
        uncertainty_m=np.linspace(0, 4e-5, n, dtype=np.float32),
        start_m=np.full(3, np.nan),
        end_m=np.zeros(3),
        cause=np.zeros(2, np.int8),
    )
    files = encode(entries)
    assert pq.ParquetFile(pa.BufferReader(files["entries.parquet"])).num_row_groups > 1
    back = decode(Measurability, files)
    assert same(back, entries)
    assert not back.view.flags.writeable  # type: ignore[attr-defined]


def test_columns_carry_unit_frame_and_meaning() -> None:
    schema = pq.read_schema(pa.BufferReader(encode(_specimen())["points.parquet"]))
    field = schema.field("point_m")
    assert field.metadata == {b"unit": b"m", b"frame": b"part", b"meaning": b"Vectors"}
    assert field.type == pa.list_(pa.field("element", pa.float32(), nullable=False), 3)
    assert not any(field.nullable for field in schema)
    assert schema.metadata[b"kind"] == b"test-specimen"


def test_the_number_of_joints_is_kept_without_a_row() -> None:
    specimen = _specimen()
    assert specimen.joints_rad.shape == (0, 6)
    assert decode(Specimen, encode(specimen)).joints_rad.shape == (0, 6)  # type: ignore[attr-defined]


def test_an_optional_column_that_is_left_out_is_no_column_of_the_file() -> None:
    specimen = replace(
        _specimen(), time_s=np.zeros(2), joints_rad=np.ones((2, 6)), flag=np.ones(2, bool), name=("a", "b")
    )
    told = replace(specimen, torque_nm=np.ones((2, 6)))
    columns = [pq.read_schema(pa.BufferReader(encode(each)["states.parquet"])).names for each in (specimen, told)]
    assert columns == [["time_s", "joints_rad", "flag", "name"], ["time_s", "joints_rad", "flag", "name", "torque_nm"]]
    back = decode(Specimen, encode(specimen)), decode(Specimen, encode(told))
    assert [each.torque_nm.shape for each in back] == [(2, 0), (2, 6)]  # type: ignore[attr-defined]


def test_a_unit_that_has_changed_is_refused() -> None:
    files = encode(tally(1, 2))
    with pytest.raises(LakeError, match="unit '', expected '12'"):
        decode(TallyInDozens, files)


@pytest.mark.parametrize(
    "table",
    [
        pa.table({"count": pa.array([1.0])}),
        pa.table({"count": pa.array([1], pa.int64())}),
        pa.table({"count": pa.array([None], pa.int32())}),
        pa.table({"counts": pa.array([1], pa.int32())}),
        pa.table({"count": pa.array([1], pa.int32()), "more": pa.array([1], pa.int32())}),
        pa.table({"count": pa.array([[1]], pa.list_(pa.int32(), 1))}),
    ],
    ids=["float", "int64", "null", "name", "extra", "vector"],
)
def test_a_table_of_another_form_is_refused(table: pa.Table) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    with pytest.raises(LakeError, match=r"counts\.parquet"):
        decode(Tally, {"counts.parquet": bytes(sink.getvalue())})


def test_a_missing_table_is_named() -> None:
    with pytest.raises(LakeError, match=r"counts\.parquet is missing"):
        decode(Tally, {})


@given(st.data())
@settings(deadline=None)
def test_damaged_files_end_in_lake_errors_or_another_digest(data: st.DataObject) -> None:
    specimen = _specimen()
    files = encode(specimen)
    name = data.draw(st.sampled_from(sorted(files)))
    content = bytearray(files[name])
    at = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        content[at] ^= 1 << data.draw(st.integers(0, 7))
    else:
        del content[at:]
    try:
        back = decode(Specimen, files | {name: bytes(content)})
    except LakeError:
        return
    # what the digest does not see are bits that no value depends on
    assert digest(back) != digest(specimen) or same(back, specimen)


@dataclass(frozen=True, eq=False, repr=False)
class _Wide(Artefact):
    KIND: ClassVar[str] = "test-wide"

    rows: Any = column("Rows", width=ANY_WIDTH)
    count: int = fact("An integer", dtype="int64")


def test_rows_without_a_value_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="rows without a value"):
        encode(_Wide(np.zeros((3, 0)), 1))


def test_a_number_that_does_not_fit_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"test-wide\.count does not fit int64"):
        encode(_Wide(np.zeros((3, 1)), 2**63))


def _specimen() -> Specimen:
    return Specimen(
        time_s=np.zeros(0),
        joints_rad=np.zeros((0, 6)),
        flag=np.zeros(0, bool),
        name=(),
        point_m=np.ones((2, 3), np.float32),
        face=np.arange(2, dtype=np.int32),
        small=np.array([-128, 127], np.int8),
        huge=np.array([0, 2**64 - 1], np.uint64),
        corner=np.ones((1, 2), np.int16),
        masks=np.array([[True, False, True]]),
        area_m2=0.1,
        count=3,
        closed=True,
        words="ö",
        content=b"bytes",
    )
