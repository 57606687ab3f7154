"""Tiny stages that stand in for the real ones where the runner itself is tested. They count their own calls."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from cellwright.arrays import FloatArray
from cellwright.errors import InfeasibleError, LakeError
from schemas.artefact import Artefact
from schemas.columns import column
from schemas.params import Params
from schemas.stage import Progress, no_progress, stage

calls: Counter[str] = Counter()
_lock = threading.Lock()


def _called(name: str) -> None:
    with _lock:
        calls[name] += 1
    if log := os.environ.get("SMALL_STAGES_LOG"):  # runs in other processes are counted by the lines of this file
        with Path(log).open("a") as file:
            file.write(f"{name}\n")


@dataclass(frozen=True, eq=False, repr=False)
class Numbers(Artefact):
    KIND: ClassVar[str] = "test-numbers"

    value: FloatArray = column("A number")


@dataclass(frozen=True, eq=False, repr=False)
class Total(Artefact):
    KIND: ClassVar[str] = "test-total"

    value: FloatArray = column("A sum")


class CountParams(Params):
    n: float = Field(default=3, ge=1)


class FactorParams(Params):
    factor: float = 2.0
    note: str = Field(default="", json_schema_extra={"keyed": False})


class NoParams(Params):
    pass


class WaitParams(Params):
    seconds: float = Field(default=0.0, json_schema_extra={"keyed": False})
    addend: float = 1.0


@stage(version=1)
def count_up(*, params: CountParams) -> Numbers:
    _called("count_up")
    return Numbers(value=np.arange(params.n))


@stage(version=1)
def scale(numbers: Numbers, *, params: FactorParams) -> Numbers:
    _called("scale")
    return Numbers(value=numbers.value * params.factor)


@stage(version=1)
def add_up(parts: tuple[Numbers, ...], extra: Numbers | None, *, params: NoParams) -> Total:
    _called("add_up")
    everything = [*parts, *([] if extra is None else [extra])]
    return Total(value=np.array([sum(part.value.sum() for part in everything)]))


@stage(version=1)
def parity(numbers: Numbers, *, params: NoParams) -> Numbers:
    """Often the same result for other inputs."""
    _called("parity")
    return Numbers(value=numbers.value.sum(keepdims=True) % 2)


@stage(version=1)
def refuse(numbers: Numbers, *, params: NoParams) -> Numbers:
    _called("refuse")
    raise InfeasibleError("the sum is 3 but must be 4: add 1")


@stage(version=1)
def crash(numbers: Numbers, *, params: NoParams) -> Numbers:
    _called("crash")
    raise ZeroDivisionError("a bug")


@stage(version=1)
def lose(numbers: Numbers, *, params: NoParams) -> Numbers:
    _called("lose")
    if calls["lose"] < 3:
        raise LakeError("the network share went away: wait")
    return numbers


@stage(version=1)
def wait(numbers: Numbers, *, params: WaitParams, progress: Progress = no_progress) -> Numbers:
    _called("wait")
    begun = time.monotonic()
    progress(0.0)
    while (elapsed := time.monotonic() - begun) < params.seconds:
        time.sleep(0.01)
        progress(elapsed / params.seconds)
    progress(1.0)
    return Numbers(value=numbers.value + params.addend)


@stage(version=1)
def lie(numbers: Numbers, *, params: NoParams) -> Total:
    return numbers  # type: ignore[return-value]  # the runner must notice


STAGES = {each.name: each for each in (count_up, scale, add_up, parity, refuse, crash, lose, wait, lie)}
