"""The Prefect side of `layout`: the flow, and what it leaves in Prefect's user interface."""

from __future__ import annotations

from prefect import flow, runtime

from flows.layout import optimise_and_report
from flows.layout_requests import LayoutRequest
from flows.layout_result import LayoutResult
from flows.prefect_pages import leave_pages
from flows.runner import task_runner


@flow(name="layout", task_runner=task_runner(), persist_result=False)
def layout(request: LayoutRequest, lake: str, refresh: list[str] | None = None, attempt: bool = False) -> LayoutResult:
    """Optimise a cell's layout by true cycle time; every stage comes from the lake if it is there."""
    run_id = str(runtime.flow_run.id)
    result = optimise_and_report(request, lake, frozenset(refresh or ()), run_id, direct=False, attempt=attempt)
    if not attempt:
        leave_pages(result, "layout")
    return result
