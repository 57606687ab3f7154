"""Turn a pure function into a stage: named, versioned, with its inputs, parameters and output declared.

A stage function takes artefacts positionally and keyword-only ``params`` (a `Params` subclass), optionally
``progress`` (called with the share done, 0 to 1), and returns one artefact. It reads its declaration off its
own annotations. A stage knows no lake, no clock and no global state; calling it is calling the function.
"""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from schemas.artefact import Artefact
from schemas.params import Params

_T = typing.TypeVar("_T")

Progress = Callable[[float], None]
"""Called by long stages with the share of the work that is done, from 0 to 1."""


def no_progress(share: float) -> None:
    """Ignore progress: the default of every stage that reports it."""


@dataclass(frozen=True, slots=True)
class StageInput:
    """One artefact input: its class, whether it is a tuple of them, whether it may be left out (``None``)."""

    artefact: type[Artefact]
    many: bool
    optional: bool


@dataclass(frozen=True)
class Stage:
    """A stage and its declaration; call it with artefacts and ``params=...``."""

    name: str
    version: int
    function: Callable[..., Artefact]
    inputs: Mapping[str, StageInput]
    params_class: type[Params]
    output: type[Artefact]
    reports_progress: bool

    def __call__(self, *artefacts: Any, **keywords: Any) -> Any:
        return self.function(*artefacts, **keywords)


def stage(*, version: int) -> Callable[[Callable[..., Artefact]], Stage]:
    """Declare a function as a stage. Raise ``version`` whenever the same inputs give another result.

    Raises:
        TypeError: If the signature is not that of a stage.
    """

    def declare(function: Callable[..., Artefact]) -> Stage:
        hints = typing.get_type_hints(function)
        inputs: dict[str, StageInput] = {}
        keywords: set[str] = set()
        for name, parameter in inspect.signature(function).parameters.items():
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
                keywords.add(name)
            elif parameter.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD:
                inputs[name] = _input(function.__name__, name, hints.get(name))
            else:
                raise TypeError(f"stage {function.__name__}: {parameter} is neither an artefact nor params")
        if unexpected := keywords - {"params", "progress"}:
            raise TypeError(f"stage {function.__name__}: unexpected keyword {min(unexpected)!r}")
        params_class, output = _class(Params, hints.get("params")), _class(Artefact, hints.get("return"))
        if "params" not in keywords or params_class is None:
            raise TypeError(f"stage {function.__name__} needs keyword-only params of a Params class")
        if output is None:
            raise TypeError(f"stage {function.__name__} returns {hints.get('return')}, not an artefact")
        declared = Stage(
            function.__name__,
            version,
            function,
            types.MappingProxyType(inputs),
            params_class,
            output,
            "progress" in keywords,
        )
        declared.__dict__["__doc__"] = function.__doc__
        return declared

    return declare


def _input(stage_name: str, name: str, hint: Any) -> StageInput:
    many = typing.get_origin(hint) is tuple
    members = [member for member in typing.get_args(hint) if member not in (types.NoneType, ...)]
    optional = not many and len(members) < len(typing.get_args(hint))
    artefact = _class(Artefact, members[0] if len(members) == 1 else hint)
    if artefact is None or (many and typing.get_args(hint)[-1] is not ...):
        raise TypeError(f"stage {stage_name}: input {name!r} is {hint}, not an artefact")
    return StageInput(artefact, many=many, optional=optional)


def _class(wanted: type[_T], hint: Any) -> type[_T] | None:
    return hint if isinstance(hint, type) and issubclass(hint, wanted) else None
