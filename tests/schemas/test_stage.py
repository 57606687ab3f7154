"""A stage reads its declaration off its annotations, and refuses what is none."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from cellwright.arrays import FloatArray
from schemas.artefact import Artefact
from schemas.columns import column
from schemas.params import Params
from schemas.references import Ref
from schemas.stage import Progress, StageInput, no_progress, stage


@dataclass(frozen=True, eq=False, repr=False)
class Length(Artefact):
    KIND: ClassVar[str] = "test-length"

    value_m: FloatArray = column("Length", unit="m")


class StretchParams(Params):
    factor: float = 2.0


@stage(version=3)
def stretch(
    one: Length,
    more: tuple[Length, ...],
    spare: Length | None = None,
    *,
    params: StretchParams,
    progress: Progress = no_progress,
) -> Length:
    """Stretch lengths."""
    progress(1.0)
    return Length(params.factor * np.concatenate([one.value_m, *(other.value_m for other in more)]))


def test_a_stage_declares_what_its_function_says() -> None:
    assert (stretch.name, stretch.version, stretch.reports_progress) == ("stretch", 3, True)
    assert stretch.inputs == {
        "one": StageInput(Length, many=False, optional=False),
        "more": StageInput(Length, many=True, optional=False),
        "spare": StageInput(Length, many=False, optional=True),
    }
    assert stretch.params_class is StretchParams
    assert stretch.output is Length
    assert stretch.__doc__ == "Stretch lengths."


def test_calling_a_stage_is_calling_its_function() -> None:
    shares: list[float] = []
    one = Length(np.array([1.0]))
    found = stretch(one, (one, one), params=StretchParams(factor=3), progress=shares.append)
    assert found.value_m.tolist() == [3.0, 3.0, 3.0]
    assert shares == [1.0]


def test_inputs_of_a_stage_cannot_be_edited() -> None:
    with pytest.raises(TypeError):
        stretch.inputs["other"] = StageInput(Length, many=False, optional=False)  # type: ignore[index]


def no_params(one: Length) -> Length: ...
def positional_params(params: StretchParams) -> Length: ...
def foreign_params(*, params: dict[str, float]) -> Length: ...
def other_keyword(*, params: StretchParams, seed: int) -> Length: ...
def plain_input(one: int, *, params: StretchParams) -> Length: ...
def plain_inputs(many: tuple[int, ...], *, params: StretchParams) -> Length: ...
def pair_input(pair: tuple[Length, Length], *, params: StretchParams) -> Length: ...
def optional_plain(one: int | None, *, params: StretchParams) -> Length: ...
def bare_input(one, *, params: StretchParams) -> Length: ...  # type: ignore[no-untyped-def]
def star_input(*all: Length, params: StretchParams) -> Length: ...
def star_keywords(*, params: StretchParams, **rest: Length) -> Length: ...
def plain_output(*, params: StretchParams) -> int: ...
def bare_output(*, params: StretchParams): ...  # type: ignore[no-untyped-def]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (no_params, "stage no_params needs keyword-only params of a Params class"),
        (positional_params, "input 'params' is .*StretchParams.*, not an artefact"),
        (foreign_params, "needs keyword-only params of a Params class"),
        (other_keyword, "unexpected keyword 'seed'"),
        (plain_input, "input 'one' is <class 'int'>, not an artefact"),
        (plain_inputs, "input 'many' is .*, not an artefact"),
        (pair_input, "input 'pair' is .*, not an artefact"),
        (optional_plain, "input 'one' is int | None, not an artefact"),
        (bare_input, "input 'one' is None, not an artefact"),
        (star_input, r"\*all: .* is neither an artefact nor params"),
        (star_keywords, r"\*\*rest: .* is neither an artefact nor params"),
        (plain_output, "returns <class 'int'>, not an artefact"),
        (bare_output, "returns None, not an artefact"),
    ],
)
def test_a_signature_that_is_no_stage_is_refused(function: Callable[..., Any], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        stage(version=1)(function)


def test_the_table_of_contents_names_every_stage_module() -> None:
    from pathlib import Path

    import tasks

    modules = {path.stem for path in Path(tasks.__file__).parent.glob("*.py")} - {"__init__"}
    assert modules == tasks.STAGES.keys()
    assert set(tasks.__all__) == {"STAGES", *tasks.STAGES}
    assert all(name == stage.name and stage.__doc__ for name, stage in tasks.STAGES.items())


def test_a_reference_travels_and_is_not_taken_apart() -> None:
    ref = Ref("test-length", "k" * 64, "d" * 64)
    assert pickle.loads(pickle.dumps(ref)) == ref
    assert str(ref) == "test-length/dddddddddddd"
    with pytest.raises(TypeError):
        iter(ref)  # type: ignore[call-overload]
    with pytest.raises(AttributeError):
        ref.kind = "other"  # type: ignore[misc]
