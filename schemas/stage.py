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
        params_class: type[Params] | None = None
        for name, parameter in inspect.signature(function).parameters.items():
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
                if name == "params":
                    params_class = hints[name]
                elif name != "progress":
                    raise TypeError(f"stage {function.__name__}: unexpected keyword {name!r}")
            else:
                inputs[name] = _input(function.__name__, name, hints[name])
        if params_class is None or not issubclass(params_class, Params):
            raise TypeError(f"stage {function.__name__} needs keyword-only params of a Params class")
        declared = Stage(
            function.__name__,
            version,
            function,
            types.MappingProxyType(inputs),
            params_class,
            hints["return"],
            "progress" in hints,
        )
        declared.__dict__["__doc__"] = function.__doc__
        return declared

    return declare


def _input(stage_name: str, name: str, hint: Any) -> StageInput:
    members = [member for member in typing.get_args(hint) if member is not type(None)]
    if typing.get_origin(hint) is tuple:
        return StageInput(members[0], many=True, optional=False)
    if members and len(members) < len(typing.get_args(hint)):
        return StageInput(members[0], many=False, optional=True)
    if isinstance(hint, type) and issubclass(hint, Artefact):
        return StageInput(hint, many=False, optional=False)
    raise TypeError(f"stage {stage_name}: input {name!r} is {hint}, not an artefact")
