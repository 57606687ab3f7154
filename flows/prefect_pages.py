"""What a finished run leaves in Prefect's user interface: its summary, and the report's figures."""

from __future__ import annotations

import base64

from prefect.artifacts import create_image_artifact, create_markdown_artifact

from flows.run_result import RunResult


def leave_pages(result: RunResult, flow: str) -> None:
    """Leave a run's summary and figures, under keys that begin with the flow's name."""
    create_markdown_artifact(result.as_markdown(), key=f"{flow}-summary", description=result.name)
    for name, picture in result.pictures().items():
        data = base64.b64encode(picture).decode()
        create_image_artifact(f"data:image/png;base64,{data}", key=f"{flow}-figure-{name}", description=name)
