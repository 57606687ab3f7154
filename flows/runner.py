"""Chain stages in a flow: each line one stage, inputs named after what they are, nothing computed twice.

    with Steps(lake_url, refresh=frozenset({"select_views"}), watcher=progress) as step:
        mesh = step(preprocess_mesh, request.mesh, source=part)
        samples = step(sample_surface, request.planning, label="planning", mesh=mesh)

A step is handed on before it is done; steps that do not wait for each other run side by side in the threads of the
flow's task runner. Inside a Prefect flow each step is a task run named after its stage, ``Cached`` or ``Completed``.
With ``direct=True`` the same stages run one after the other in this thread, without Prefect: for tests and notebooks.

A failing stage raises its own error where its result, or the result of anything behind it, is asked for.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextvars import ContextVar
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from flows.execution import (
    RECORDER,
    WATCHER,
    Outcome,
    Unwatched,
    Watcher,
    checked_inputs,
    open_lake,
    run_in_lake,
    run_patiently,
    stage_named,
    validated_params,
)
from flows.run_record import RunRecord, StepRecord
from schemas.artefact import Artefact
from schemas.params import Params
from schemas.references import Ref
from schemas.stage import Stage

if TYPE_CHECKING:
    from prefect.futures import PrefectFuture
    from prefect.task_runners import TaskRunner


_WATCHING: ContextVar[Watcher | None] = ContextVar("run_watcher", default=None)


@contextlib.contextmanager
def watched(watcher: Watcher | None) -> Iterator[None]:
    """Let the runs begun in here tell a watcher what they do; it stays in this process and never travels."""
    watching = _WATCHING.set(watcher)
    try:
        yield
    finally:
        _WATCHING.reset(watching)


def task_runner() -> TaskRunner[Any]:
    """Return the task runner for flows that use `Steps`: threads, as many as there are cores."""
    from prefect.task_runners import ThreadPoolTaskRunner

    return ThreadPoolTaskRunner(max_workers=max(2, os.cpu_count() or 1))


class Step:
    """A stage that is under way or done: hand it to other steps, or ask for its reference."""

    def __init__(self, stage: Stage, name: str, upstream: tuple[Step, ...]) -> None:
        self.stage = stage
        self.name = name
        self._upstream = upstream
        self._future: PrefectFuture[Ref] | None = None
        self._outcome: Outcome | None = None
        self._ref: Ref | None = None
        self._failure: Exception | None = None

    def __repr__(self) -> str:
        return f"Step({self.name})"

    def ref(self) -> Ref:
        """Wait for the step and return the reference to its artefact.

        Raises:
            CellwrightError: The error of the first stage that failed on the way here, never that of its victim.
        """
        if self._ref is None:
            # kept, because the chain has so many ways back that asking along all of them takes seconds
            self._ref = self._awaited()
        return self._ref

    def _awaited(self) -> Ref:
        for step in self._upstream:
            step.ref()
        if self._outcome is not None:
            return self._outcome.ref
        if self._future is None:
            raise RuntimeError(f"step {self.name} was never started")
        try:
            return self._future.result()
        except Exception as error:
            self._failure = error
            raise


class Steps:
    """Runs the stages of one flow run against one lake, as a context manager.

    Leaving it waits for every step. Leaving it by an error waits for none: steps under way go on until the flow's
    task runner ends, and what they make still comes onto the record of the run, which has failed by then.

    Args:
        lake_url: Folder or object-store address of the lake.
        refresh: Names of stages to compute although the lake has them.
        watcher: Hears of starts, progress and ends, in this process; that of `watched` if left out.
        direct: Call the stages one after the other in this thread, without Prefect.
        run_id: Id under which the run is written down in the lake, from its first moment to its last, so that what
            it used is kept when the lake is swept, however it ends; not written down if empty.
        facts: What else its record says.

    Raises:
        InvalidInputError: If ``refresh`` names a stage that does not exist.
    """

    def __init__(
        self,
        lake_url: str,
        *,
        refresh: Collection[str] = frozenset(),
        watcher: Watcher | None = None,
        direct: bool = False,
        run_id: str = "",
        facts: Mapping[str, Any] | None = None,
    ) -> None:
        for name in refresh:
            stage_named(name)
        self._lake_url = lake_url
        self._refresh = frozenset(refresh)
        self._watcher = watcher or _WATCHING.get() or Unwatched()
        self._direct = direct
        self._run_id = run_id
        self._record = RunRecord(open_lake(lake_url) if run_id else None, run_id, facts or {})
        self._steps: dict[str, Step] = {}
        self._refused: list[Step] = []
        self.notes: list[str] = []
        """What a person should know of the run itself, once it is left."""

    def __enter__(self) -> Self:
        self._record.begin()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            try:
                records = self.records()
            except BaseException as failure:
                self._record.fail(failure, self.failed(failure))
                raise
            if (refusal := self._record.finish(records)) is not None:
                self.note(f"this run is not on record, so a sweep of the lake does not know of it: {refusal}")
        else:
            self._record.fail(error, self.failed(error))

    def note(self, text: str) -> None:
        """Tell a person something of the run itself, now and with its result."""
        self.notes.append(text)
        self._watcher.noted(f"warning: {text}")

    def forgive(self, error: BaseException) -> None:
        """Leave the step that raised an error out of the run, for the flow goes on without it."""
        self._steps = {name: each for name, each in self._steps.items() if each._failure is not error}
        self._refused = [each for each in self._refused if each._failure is not error]

    def named(self, name: str) -> Step | None:
        """Return a step of this run by its name, ``None`` if it was not started."""
        return self._steps.get(name)

    def failed(self, error: BaseException) -> str:
        """Return the name of the step that raised an error, empty if it came from none."""
        return next((each.name for each in (*self._steps.values(), *self._refused) if each._failure is error), "")

    def handed_to_failed(self, error: BaseException, artefact: type[Artefact]) -> Step | None:
        """Return the step that made the artefact of a class for the step that raised an error, if there is one."""
        failed = (each for each in (*self._steps.values(), *self._refused) if each._failure is error)
        return next((one for each in failed for one in each._upstream if one.stage.output is artefact), None)

    def done(self) -> list[StepRecord]:
        """Return what is known to have ended well so far, whatever became of the rest."""
        return self._record.steps()

    def __call__(self, stage: Stage, params: Params | Mapping[str, Any], /, *, label: str = "", **inputs: Any) -> Step:
        """Start a stage on its inputs: steps, references, tuples of them, or ``None`` where it allows that.

        Args:
            stage: The stage, one of `tasks.STAGES`.
            params: Its parameters, checked before anything runs.
            label: Tells apart several steps of one stage.
            inputs: Its inputs by name.

        Raises:
            InvalidInputError: If the parameters do not fit the stage.
            TypeError: If the inputs are not those that the stage takes.
            CellwrightError: With ``direct``, what the stage raises.
        """
        checked = validated_params(stage, params)
        checked_inputs(stage, {name: _each(given, _expected) for name, given in inputs.items()})
        upstream = tuple(one for given in inputs.values() for one in _members(given) if isinstance(one, Step))
        step = Step(stage, self._free_name(stage, label), upstream)
        refresh = stage.name in self._refresh
        with self._listening():
            if self._direct:
                ready = {name: _each(given, _ready) for name, given in inputs.items()}
                lake = open_lake(self._lake_url)
                try:
                    step._outcome = run_patiently(
                        lambda: run_in_lake(
                            stage, lake, checked, ready, name=step.name, refresh=refresh, run_id=self._run_id
                        )
                    )
                except Exception as error:
                    step._failure = error
                    self._refused.append(step)
                    raise
            else:
                from flows.stage_task import task_for

                pending = {name: _each(given, _pending) for name, given in inputs.items()}
                plain = checked.model_dump(mode="json")
                step._future = task_for(stage.name, step.name).submit(
                    stage.name, step.name, self._lake_url, plain, pending, refresh
                )
        self._steps[step.name] = step
        return step

    def records(self) -> list[StepRecord]:
        """Wait for every step and return what became of each, in the order in which they were started.

        Raises:
            CellwrightError: The error of the first step that failed.
        """
        return [self._ended(step) for step in self._steps.values()]

    def _ended(self, step: Step) -> StepRecord:
        ref = step.ref()
        # a step that ran in another process is not heard of here: its reference is all that is known
        return self._record.of(step.name) or StepRecord(step.name, step.stage.name, step.stage.version, ref, False, 0.0)

    @contextlib.contextmanager
    def _listening(self) -> Iterator[None]:
        watching, recording = WATCHER.set(self._watcher), RECORDER.set(self._record)
        try:
            yield
        finally:
            RECORDER.reset(recording)
            WATCHER.reset(watching)

    def _free_name(self, stage: Stage, label: str) -> str:
        wanted = f"{stage.name} {label}".strip()
        name, count = wanted, 1
        while name in self._steps:
            count += 1
            name = f"{wanted} {count}"
        return name


def _members(given: Any) -> tuple[Any, ...]:
    return given if isinstance(given, tuple) else (given,)


def _each(given: Any, change: Callable[[Any], Any]) -> Any:
    return tuple(change(one) for one in given) if isinstance(given, tuple) else change(given)


def _expected(one: Any) -> Any:
    """Stand in for a step that is not done, so that its kind can be checked before anything runs."""
    return Ref(one.stage.output.KIND, "", "") if isinstance(one, Step) else one


def _ready(one: Any) -> Any:
    return one.ref() if isinstance(one, Step) else one


def _pending(one: Any) -> Any:
    return one._future if isinstance(one, Step) else one
