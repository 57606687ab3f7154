"""The Prefect side of `sequence`: the flow, and what it leaves in Prefect's user interface."""

from __future__ import annotations

from prefect import flow, runtime

from flows.prefect_pages import leave_pages
from flows.runner import task_runner
from flows.sequence import sequence_and_record
from flows.sequence_requests import SequenceRequest
from flows.sequence_result import SequenceResult


@flow(name="sequence", task_runner=task_runner(), persist_result=False)
def sequence(request: SequenceRequest, lake: str, refresh: list[str] | None = None) -> SequenceResult:
    """Find, verify and report the sequence of tasks at poses; every stage comes from the lake if it is there."""
    run_id = str(runtime.flow_run.id)
    result = sequence_and_record(request, lake, frozenset(refresh or ()), run_id=run_id, direct=False)
    leave_pages(result, "sequence")
    return result
