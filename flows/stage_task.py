"""The one Prefect task: `run_stage` runs any stage by its name, with the lake as the cache.

Only the lake's address, the stage's name, plain parameters and references travel, so that a task runs the same in a
thread, in another process or on another machine. Prefect caches and persists nothing: the task asks the lake first
and then ends in the state ``Cached``. Lake errors are retried by Prefect, nothing else is.
"""

from __future__ import annotations

import functools
from typing import Any

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.client.schemas.objects import State, TaskRun
from prefect.runtime import flow_run
from prefect.settings import get_current_settings
from prefect.states import Completed

from cellwright.errors import LakeError
from flows.execution import RETRIES, RETRY_DELAY_S, RefInput, open_lake, run_in_lake, stage_named
from schemas.references import Ref


def is_lake_error(task: Task[..., Any], task_run: TaskRun, state: State[Any]) -> bool:
    """Whether a task ended in a lake error, the only kind worth another try."""
    return isinstance(state.data, LakeError)


@task(
    cache_policy=NO_CACHE,
    persist_result=False,
    retries=RETRIES,
    retry_delay_seconds=RETRY_DELAY_S,
    retry_condition_fn=is_lake_error,
)
def run_stage(
    stage_name: str,
    name: str,
    lake_url: str,
    params: dict[str, Any],
    inputs: dict[str, RefInput],
    refresh: bool,
) -> Ref | State[Ref]:
    """Return the reference of a stage's artefact: as a ``Cached`` state where the lake has it.

    Raises:
        CellwrightError: Whatever stage or lake raise on purpose.
    """
    outcome = run_in_lake(
        stage_named(stage_name),
        open_lake(lake_url),
        params,
        inputs,
        name=name,
        refresh=refresh or bool(get_current_settings().tasks.refresh_cache),
        run_id=str(flow_run.id or ""),
    )
    if outcome.cached:
        return Completed(name="Cached", message=f"{outcome.ref} was in the lake", data=outcome.ref)
    return outcome.ref


@functools.cache
def task_for(stage_name: str, name: str) -> Task[..., Any]:
    """Return `run_stage` under a stage's own name, its run named like the step."""
    return run_stage.with_options(name=stage_name, task_run_name=name.replace("{", "{{").replace("}", "}}"))
