"""Run one stage against the lake: ask first, else load the inputs, compute, publish.

This is the whole caching logic, and it knows no Prefect: the same function serves the flows, unit tests and
notebooks. Guarantees: parameters are validated before they are keyed; one key is computed once on a machine, also
when two runs want it at the same moment; nothing is published before it is whole; a refreshed stage is computed
again and replaces what was stored. Asking costs one small file; no array is read for a stage that is cached.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import os
import platform
import threading
import time
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from pydantic import ValidationError

from cellwright.errors import InvalidInputError, LakeError, listed
from schemas.artefact import Artefact
from schemas.params import Params
from schemas.references import Ref
from schemas.stage import Stage

if TYPE_CHECKING:
    from storage.lake import Lake

RETRIES = 2
"""A lake error is tried again so many times: a network share or an object store hiccups, a stage does not."""

RETRY_DELAY_S = 0.5

RefInput = Ref | tuple[Ref, ...] | None
"""What a stage input may be: one artefact, several in order, or none where the stage allows it."""


class Watcher(Protocol):
    """Hears of the stages of a run while they happen; called from several threads."""

    def started(self, name: str) -> None:
        """A stage is not in the lake and is computed now."""

    def advanced(self, name: str, share: float) -> None:
        """A stage reports the share of its work that is done, 0 to 1."""

    def finished(self, name: str, *, cached: bool, seconds: float) -> None:
        """A stage's artefact is in the lake; ``seconds`` is the time since the stage was asked for."""

    def failed(self, name: str) -> None:
        """A stage raised."""

    def noted(self, line: str) -> None:
        """Something about the run itself is worth a line."""


class Recorder(Protocol):
    """Takes down the steps of a run; called from several threads."""

    def making(self) -> None:
        """A stage is about to be computed."""

    def add(self, name: str, stage: Stage, outcome: Outcome) -> None:
        """A step ended well."""


class Unwatched:
    """The watcher that does nothing."""

    def started(self, name: str) -> None:
        """Ignore it."""

    def advanced(self, name: str, share: float) -> None:
        """Ignore it."""

    def finished(self, name: str, *, cached: bool, seconds: float) -> None:
        """Ignore it."""

    def failed(self, name: str) -> None:
        """Ignore it."""

    def noted(self, line: str) -> None:
        """Ignore it."""


_UNWATCHED = Unwatched()

WATCHER: ContextVar[Watcher] = ContextVar("watcher", default=_UNWATCHED)
"""The watcher of the run that the current thread works for. It stays in this process and never travels."""


REFRESHED: ContextVar[set[str] | None] = ContextVar("refreshed", default=None)
"""Keys that were made anew already, where several runs refresh the same stages: each is refreshed once."""

RECORDER: ContextVar[Recorder | None] = ContextVar("recorder", default=None)
"""The record of the run that the current thread works for. Stays in this process like `WATCHER`."""

INTERRUPTED = threading.Event()
"""Set when the person wants the command to stop: a stage in a thread ends at its next report of progress."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one stage: its artefact, whether the lake had it, and the time from asking to having."""

    ref: Ref
    cached: bool
    seconds: float


def stage_named(name: str) -> Stage:
    """Look a stage up in the table of contents of `tasks`.

    Raises:
        InvalidInputError: If there is no such stage.
    """
    stages: Mapping[str, Stage] = importlib.import_module("tasks").STAGES
    if name not in stages:
        near = difflib.get_close_matches(name, stages, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"the stages are {listed(sorted(stages), most=40)}"
        raise InvalidInputError(f"there is no stage {name!r}: {hint}")
    return stages[name]


def validated_params(stage: Stage, params: Params | Mapping[str, Any]) -> Params:
    """Return a stage's parameters as its own class, whatever they arrived as.

    Raises:
        InvalidInputError: If a value does not fit; the message names field, fault and value.
    """
    if isinstance(params, stage.params_class):
        return params
    try:
        return stage.params_class.model_validate(params.model_dump() if isinstance(params, Params) else dict(params))
    except ValidationError as error:
        faults = [
            f"{'.'.join(map(str, fault['loc']))}: {fault['msg']} (got {fault['input']!r})" for fault in error.errors()
        ]
        raise InvalidInputError(f"parameters of {stage.name}: {listed(faults)}") from error


def checked_inputs(stage: Stage, inputs: Mapping[str, RefInput]) -> dict[str, RefInput]:
    """Check names, number and kinds of a stage's inputs; return them in the order of its declaration.

    Raises:
        TypeError: If the flow hands the stage something it does not take: a mistake in the flow, not of its user.
    """
    if unknown := set(inputs) - set(stage.inputs):
        raise TypeError(f"stage {stage.name} has no input {listed(sorted(unknown))}; it takes {list(stage.inputs)}")
    ordered: dict[str, RefInput] = {}
    for name, declared in stage.inputs.items():
        given = inputs.get(name)
        if given is None and not declared.optional:
            raise TypeError(f"stage {stage.name} needs the input {name!r}")
        if given is not None and declared.many != isinstance(given, tuple):
            raise TypeError(f"stage {stage.name} takes {'several' if declared.many else 'one'} as input {name!r}")
        for ref in references(given):
            if ref.kind != declared.artefact.KIND:
                raise TypeError(f"input {name!r} of {stage.name} is a {declared.artefact.KIND}, not a {ref.kind}")
        ordered[name] = given
    return ordered


def references(given: RefInput) -> tuple[Ref, ...]:
    """Return the references in one input: none, one or several."""
    if given is None:
        return ()
    return given if isinstance(given, tuple) else (given,)


@functools.lru_cache(maxsize=8)
def open_lake(url: str) -> Lake:
    """Open a lake once in this process."""
    from storage.lake import Lake

    return Lake(url)


def run_in_lake(
    stage: Stage,
    lake: Lake,
    params: Params | Mapping[str, Any],
    inputs: Mapping[str, RefInput],
    *,
    name: str = "",
    refresh: bool = False,
    run_id: str = "",
) -> Outcome:
    """Return the stage's artefact from the lake, made now if it is not there or ``refresh`` is set.

    Args:
        stage: What to run.
        lake: Where artefacts are.
        params: The stage's parameters, checked here.
        inputs: References by input name.
        name: What watchers call this step; the stage's name if empty.
        refresh: Compute even if the lake has it.
        run_id: Noted beside the artefact: the run that made it.

    Raises:
        InvalidInputError: If the parameters do not fit the stage.
        LakeError: If the lake fails or an input is damaged.
        CellwrightError: Whatever the stage itself raises on purpose.
    """
    from flows.versions import versions
    from storage.manifests import Recipe

    watcher, recorder, name, asked = WATCHER.get(), RECORDER.get(), name or stage.name, time.monotonic()
    cached = True

    def make() -> Ref:
        nonlocal cached
        cached = False
        if recorder is not None:
            recorder.making()
        watcher.started(name)
        artefacts = [_loaded(lake, refs) for refs in given.values()]
        begun, worked = time.monotonic(), _processor_s()
        artefact = _computed(stage, artefacts, checked, name)
        seconds = round(time.monotonic() - begun, 6)
        # of the whole process and those that it began: right where no other stage ran beside this one
        cpu_seconds = round(_processor_s() - worked, 6)
        made = {
            "seconds": seconds,
            "cpu_seconds": cpu_seconds,
            "host": platform.node(),
            "run": run_id,
            "versions": versions(),
        }
        return lake.publish(recipe.key, artefact, recipe, made)

    try:
        checked, given = validated_params(stage, params), checked_inputs(stage, inputs)
        digests = {each: _digests(refs) for each, refs in given.items()}
        recipe = Recipe(stage.name, stage.version, checked.canonical(), digests)
        refreshed = REFRESHED.get()
        ref = _found_or_made(lake, recipe.key, make, refresh and recipe.key not in (refreshed or ()))
        if refresh and refreshed is not None:
            refreshed.add(recipe.key)
    except BaseException:
        watcher.failed(name)
        raise
    outcome = Outcome(ref, cached, time.monotonic() - asked)
    watcher.finished(name, cached=cached, seconds=outcome.seconds)
    if recorder is not None:
        recorder.add(name, stage, outcome)
    return outcome


def run_patiently(run: Callable[[], Outcome]) -> Outcome:
    """Call ``run`` again after a lake error, `RETRIES` times: what Prefect's retries do, without Prefect.

    Raises:
        LakeError: The last one, once the retries are used up.
    """
    for _ in range(RETRIES):
        try:
            return run()
        except LakeError:
            time.sleep(RETRY_DELAY_S)
    return run()


def _processor_s() -> float:
    """Return the processor time of this process and of those that it began and has waited for."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _found_or_made(lake: Lake, key: str, make: Callable[[], Ref], refresh: bool) -> Ref:
    if refresh:
        with lake.alone(key):
            return make()
    if (ref := lake.find(key)) is not None:
        return ref
    with lake.alone(key):  # another run may have made it while this one waited
        return lake.find(key) or make()


def _digests(given: RefInput) -> str | list[str] | None:
    if isinstance(given, tuple):
        return [ref.digest for ref in given]
    return None if given is None else given.digest


def _loaded(lake: Lake, given: RefInput) -> Artefact | tuple[Artefact, ...] | None:
    if isinstance(given, tuple):
        return tuple(lake.load(ref) for ref in given)
    return None if given is None else lake.load(given)


def _computed(stage: Stage, artefacts: list[Any], params: Params, name: str) -> Artefact:
    watcher = WATCHER.get()

    def advance(share: float) -> None:
        if INTERRUPTED.is_set():
            raise KeyboardInterrupt
        watcher.advanced(name, share)

    keywords: dict[str, Any] = {"params": params}
    if stage.reports_progress:
        keywords["progress"] = advance
    artefact = stage(*artefacts, **keywords)
    if not isinstance(artefact, stage.output):
        raise TypeError(f"stage {stage.name} returned a {type(artefact).__name__}, not a {stage.output.__name__}")
    return artefact
