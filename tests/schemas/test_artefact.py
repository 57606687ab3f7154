"""The artefact contract: what is declared is what is held, frozen, and named by its content alone."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwright.arrays import BoolArray, Float32Array, FloatArray, Int32Array
from cellwright.errors import InvalidInputError
from schemas.artefact import Artefact, artefact_class, columns, digest, held, specs
from schemas.columns import ANY_WIDTH, blob, column, fact

PROJECT = Path(__file__).parents[2]


@dataclass(frozen=True, eq=False, repr=False)
class Everything(Artefact):
    """One field of every sort."""

    KIND: ClassVar[str] = "test-everything"

    point_m: FloatArray = column("Points", width=3, unit="m", frame="part", table="points")
    near: BoolArray = column("Whether it is near", dtype="bool", table="points")
    q_rad: FloatArray = column("Joints", width=ANY_WIDTH, unit="rad", table="states")
    row: Int32Array = column("Row", dtype="int32", table="states")
    share: Float32Array = column("Share", dtype="float32", table="states")
    name: tuple[str, ...] = column("Names", dtype="str", table="names")
    title: str = fact("Title", dtype="str")
    closed: bool = fact("Closed", dtype="bool")
    count: int = fact("Count", dtype="int64")
    length: float = fact("Length", unit="m")
    content: bytes = blob("Bytes", suffix=".bin")


def values(**changes: Any) -> dict[str, Any]:
    return {
        "point_m": np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]),
        "near": np.array([True, False]),
        "q_rad": np.arange(6.0).reshape(3, 2),
        "row": np.array([1, 2, 3], np.int32),
        "share": np.array([0.5, 0.25, 0.125], np.float32),
        "name": ("a", "b"),
        "title": "t",
        "closed": True,
        "count": 7,
        "length": 0.5,
        "content": b"\0\1",
        **changes,
    }


def everything(**changes: Any) -> Everything:
    return Everything(**values(**changes))


def test_arrays_of_an_artefact_cannot_be_written() -> None:
    artefact = everything()
    for name in ("point_m", "near", "q_rad", "row", "share"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(artefact, name)[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        artefact.title = "other"  # type: ignore[misc]


def test_what_fits_without_loss_is_converted() -> None:
    artefact = everything(
        point_m=np.zeros((2, 3), np.int64),
        row=np.array([1, 2, 3]),
        name=np.array(["a", "b"]),
        count=np.int32(7),
        length=1,
        closed=np.bool_(True),
    )
    assert artefact.point_m.dtype == np.float64
    assert artefact.row.dtype == np.int32
    assert artefact.name == ("a", "b")
    assert [type(value) for value in (artefact.name[0], artefact.count, artefact.length, artefact.closed)] == [
        str, int, float, bool,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"point_m": np.zeros((2, 2))}, r"test-everything.point_m has shape \(2, 2\), not \(rows, 3\)"),
        ({"point_m": np.zeros(3)}, r"has shape \(3,\)"),
        ({"q_rad": np.zeros(3)}, r"q_rad has shape \(3,\)"),
        ({"row": np.zeros((3, 1), np.int32)}, r"row has shape \(3, 1\), not \(rows,\)"),
        ({"row": np.array([1.0, 2.0, 3.0])}, "row has dtype float64, which does not fit int32"),
        ({"row": np.array([1, 2, 2**40])}, "row holds 1 to 1099511627776, which does not fit int32"),
        ({"near": np.array([1, 0])}, "near has dtype int64, which does not fit bool"),
        ({"near": np.array([True])}, "near has 1 rows but table 'points' has 2"),
        ({"share": np.zeros(2, np.float32)}, "share has 2 rows but table 'states' has 3"),
        ({"point_m": np.array([["x"] * 3] * 2)}, "point_m has dtype <U1"),
        ({"name": "ab"}, "name must be a sequence of texts, not 'ab'"),
        ({"name": (1, 2)}, r"name must be a sequence of texts, not \(1, 2\)"),
        ({"title": 3}, "title is 3, which is no str"),
        ({"closed": 1}, "closed is 1, which is no bool"),
        ({"count": 2.5}, "count is 2.5, which is no int64"),
        ({"count": True}, "count is True, which is no int64"),
        ({"length": "1"}, "length is '1', which is no float64"),
        ({"content": "text"}, "content must be bytes, not str"),
    ],
)
def test_what_does_not_fit_its_declaration_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        everything(**change)


CHANGES: dict[str, Any] = {
    "point_m": np.array([[0.0, 1.0, 2.0], [3.0, 4.0, np.nextafter(5.0, 6.0)]]),
    "near": np.array([True, True]),
    "q_rad": np.arange(6.0).reshape(3, 2)[:, ::-1],
    "row": np.array([1, 3, 2]),
    "share": np.array([0.5, 0.25, np.nan], np.float32),
    "name": ("ab", ""),
    "title": "u",
    "closed": False,
    "count": 8,
    "length": 0.25,
    "content": b"\0\2",
}


def test_every_field_is_in_the_digest() -> None:
    assert CHANGES.keys() == specs(Everything).keys()
    digests = {digest(everything(**{name: value})) for name, value in CHANGES.items()}
    assert len(digests) == len(CHANGES)
    assert digest(everything()) not in digests


def test_the_digest_is_of_the_content_not_of_how_it_is_held() -> None:
    transposed = np.asfortranarray(values()["point_m"])
    padded = np.zeros((3, 4))
    padded[:, :2] = values()["q_rad"]
    assert digest(everything(point_m=transposed, q_rad=padded[:, :2], row=np.array([1, 2, 3]))) == digest(everything())
    assert digest(everything(name=["a", "b"])) == digest(everything())


def test_the_width_of_an_open_column_is_in_the_digest() -> None:
    flat = np.arange(6.0)
    kept = {"row": np.zeros(6, np.int32), "share": np.zeros(6, np.float32)}
    assert digest(everything(q_rad=flat.reshape(6, 1), **kept)) != digest(
        everything(q_rad=np.repeat(flat[:, None], 2, axis=1), **kept)
    )


@given(st.lists(st.text(max_size=3), max_size=4), st.lists(st.text(max_size=3), max_size=4))
def test_only_equal_texts_have_equal_digests(one: list[str], other: list[str]) -> None:
    assert (digest(everything(name=one)) == digest(everything(name=other))) == (one == other)


def test_the_digest_is_the_same_on_every_day() -> None:
    # golden: lakes written with other digests would be worthless
    assert digest(everything()) == "9e36e7f07105dbe240ef01da6ed8aa4d1f1c3e4facb55f5d270a254312771bd7"


def test_the_digest_is_the_same_in_another_process() -> None:
    code = "from tests.schemas.test_artefact import everything; from schemas.artefact import digest; "
    done = subprocess.run(
        [sys.executable, "-c", f"{code} print(digest(everything()))"], cwd=PROJECT, capture_output=True, text=True
    )
    assert done.stdout.strip() == digest(everything()), done.stderr


def test_a_kind_is_found_by_its_name_and_is_declared_once() -> None:
    assert artefact_class("test-everything") is Everything
    with pytest.raises(InvalidInputError, match="unknown artefact kind 'test-nothing'"):
        artefact_class("test-nothing")
    with pytest.raises(TypeError, match="'test-everything' is declared by Everything and Another"):

        class Another(Artefact):
            KIND: ClassVar[str] = "test-everything"


@dataclass(frozen=True, eq=False, repr=False)
class Plain(Artefact):
    """What `Grown` was before it got a column."""

    KIND: ClassVar[str] = "test-plain"

    row: Int32Array = column("Row", dtype="int32", table="states")
    length: float = fact("Length", unit="m")


@dataclass(frozen=True, eq=False, repr=False)
class Grown(Artefact):
    """The same with a column that may be left out, before a fact that may not."""

    KIND: ClassVar[str] = "test-grown"

    row: Int32Array = column("Row", dtype="int32", table="states")
    torque_nm: FloatArray = column("Torques", width=ANY_WIDTH, unit="N m", table="states", optional=True)
    length: float = fact("Length", unit="m")


def test_an_artefact_without_its_optional_column_is_the_one_before_it_was_declared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    grown = Grown(np.arange(3, dtype=np.int32), 0.5)
    assert grown.torque_nm.shape == (3, 0) and not grown.torque_nm.flags.writeable
    assert dataclasses.replace(grown, row=np.arange(5, dtype=np.int32)).torque_nm.shape == (5, 0)
    assert held(grown).keys() == {"row", "length"}
    told = Grown(np.arange(3, dtype=np.int32), 0.5, torque_nm=np.zeros((3, 2)))
    assert held(told).keys() == {"row", "torque_nm", "length"} and digest(told) != digest(grown)
    monkeypatch.setattr(Grown, "KIND", Plain.KIND)
    assert digest(grown) == digest(Plain(np.arange(3, dtype=np.int32), 0.5))


def test_an_optional_column_has_the_rows_of_its_table_and_an_open_width() -> None:
    with pytest.raises(InvalidInputError, match="torque_nm has 2 rows but table 'states' has 3"):
        Grown(np.arange(3, dtype=np.int32), 0.5, torque_nm=np.ones((2, 2)))
    with pytest.raises(InvalidInputError, match="torque_nm has 0 rows but table 'states' has 3"):
        Grown(np.arange(3, dtype=np.int32), 0.5, torque_nm=np.ones((0, 2)))
    assert Grown(np.zeros(0, np.int32), 0.5, torque_nm=np.ones((0, 2))).torque_nm.shape == (0, 0)
    with pytest.raises(TypeError, match="an optional column has width ANY_WIDTH"):
        column("Three", width=3, optional=True)


def test_an_artefact_is_shown_by_its_tables() -> None:
    assert repr(everything()) == "Everything(points: 2, states: 3, names: 2)"


def test_every_declared_field_of_the_product_says_what_it_means() -> None:
    import tasks

    for stage in tasks.STAGES.values():
        for name, spec in specs(stage.output).items():
            assert spec.meaning, f"{stage.output.__name__}.{name}"
            for unit in ("_m", "_rad", "_s", "_ns", "_m2", "_rad_s", "_rad_s2"):
                if name.endswith(unit) and spec.dtype != "str" and not name.startswith("T_"):
                    assert spec.unit, f"{stage.output.__name__}.{name} carries a unit in its name only"
        assert list(columns(stage.output)) == [n for n, s in specs(stage.output).items() if s.role == "column"]
