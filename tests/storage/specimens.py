"""Small artefacts of every declared form, and recipes for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from schemas.artefact import Artefact, specs
from schemas.columns import ANY_WIDTH, blob, column, fact
from storage.manifests import Recipe


@dataclass(frozen=True, eq=False, repr=False)
class Specimen(Artefact):
    """One field of every form."""

    KIND: ClassVar[str] = "test-specimen"

    time_s: Any = column("Flat float64", unit="s", table="states")
    joints_rad: Any = column("Open width", width=ANY_WIDTH, unit="rad", table="states")
    flag: Any = column("Flat bool", dtype="bool", table="states")
    name: tuple[str, ...] = column("Words", dtype="str", table="states")
    torque_nm: Any = column("May be left out", width=ANY_WIDTH, unit="N m", table="states", optional=True)
    point_m: Any = column("Vectors", dtype="float32", width=3, unit="m", frame="part", table="points")
    face: Any = column("Flat int32", dtype="int32", table="points")
    small: Any = column("Flat int8", dtype="int8", table="points")
    huge: Any = column("Flat uint64", dtype="uint64", table="points")
    corner: Any = column("Integer vectors", dtype="int16", width=2, table="corners")
    masks: Any = column("Bool vectors", dtype="bool", width=ANY_WIDTH, table="corners")
    area_m2: float = fact("A float", unit="m^2")
    count: int = fact("An integer", dtype="int64")
    closed: bool = fact("A truth", dtype="bool")
    words: str = fact("A text", dtype="str")
    content: bytes = blob("A file", suffix=".bin")


@dataclass(frozen=True, eq=False, repr=False)
class Tally(Artefact):
    """The smallest artefact: one column."""

    KIND: ClassVar[str] = "test-tally"

    count: Any = column("Counts", dtype="int32", table="counts")


@dataclass(frozen=True, eq=False, repr=False)
class TallyInDozens(Artefact):
    """A tally whose unit has changed."""

    KIND: ClassVar[str] = "test-tally-in-dozens"

    count: Any = column("Counts", dtype="int32", unit="12", table="counts")


_TEXT = st.text(st.characters(exclude_categories=("Cs",)), max_size=8)
_FIXED = {"point_m": 3, "corner": 2}


@st.composite
def specimens(draw: st.DrawFn) -> Specimen:
    """Any specimen: empty tables, open widths, NaN payloads, negative zeros, odd texts."""
    rows = {table: draw(st.integers(0, 5)) for table in ("states", "points", "corners")}
    values: dict[str, Any] = {}
    for name, spec in specs(Specimen).items():
        if spec.role != "column":
            continue
        n_rows = rows[spec.table]
        if spec.dtype == "str":
            values[name] = tuple(draw(st.lists(_TEXT, min_size=n_rows, max_size=n_rows)))
            continue
        width = _FIXED.get(name, draw(st.integers(0 if n_rows == 0 or spec.optional else 1, 4)))
        shape = (n_rows,) if spec.width is None else (n_rows, width)
        values[name] = draw(hnp.arrays(np.dtype(spec.dtype), shape))
    return Specimen(
        **values,
        area_m2=draw(st.floats()),
        count=draw(st.integers(-(2**63), 2**63 - 1)),
        closed=draw(st.booleans()),
        words=draw(_TEXT),
        content=draw(st.binary(max_size=40)),
    )


def same(one: Artefact, other: Artefact) -> bool:
    """Whether two artefacts are equal bit for bit."""
    if type(one) is not type(other):
        return False
    for name in specs(type(one)):
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(a, np.ndarray):
            if a.dtype != b.dtype or a.shape != b.shape or a.tobytes() != b.tobytes():
                return False
        elif isinstance(a, float):
            if np.float64(a).tobytes() != np.float64(b).tobytes():
                return False
        elif a != b:
            return False
    return True


def tally(*counts: int) -> Tally:
    """Make a tally."""
    return Tally(np.array(counts, np.int32))


def recipe(stage: str = "count", /, inputs: dict[str, Any] | None = None, **params: Any) -> Recipe:
    """Make a recipe."""
    return Recipe(stage, 1, params, inputs or {})
