"""The Prefect side of `inspect`: the flow, and what it leaves in Prefect's user interface."""

from __future__ import annotations

from prefect import flow, runtime
from prefect.artifacts import create_markdown_artifact, create_table_artifact

from cellwright.errors import CellwrightError
from flows.findings import noting
from flows.inspection import FINDINGS, plan_and_record
from flows.inspection_result import InspectionResult
from flows.prefect_pages import leave_pages
from flows.requests import InspectionRequest
from flows.runner import task_runner


@flow(name="inspect", task_runner=task_runner(), persist_result=False)
def inspect(request: InspectionRequest, lake: str, refresh: list[str] | None = None) -> InspectionResult:
    """Plan, verify and report a laser-scan inspection; every stage comes from the lake if it is there."""
    run_id = str(runtime.flow_run.id)
    given = FINDINGS.get()
    found = [] if given is None else given
    try:
        result = plan_and_record(request, lake, frozenset(refresh or ()), run_id=run_id, direct=False, found=found)
    except CellwrightError as error:
        for each in found:
            with noting(error, "showing the findings in Prefect"):
                create_markdown_artifact(each.as_markdown(), key="inspection-findings", description=request.name)
        raise
    leave_pages(result, "inspection")
    create_table_artifact(result.coverage_rows(), key="inspection-coverage", description="Coverage by cause")
    return result
