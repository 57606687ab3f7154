"""A flow run without a plan: the stage's own error, and its findings in Prefect's user interface."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellwright.errors import InfeasibleError
from flows import inspection
from flows.findings import Findings
from tests.small_inspection import write_cell

pytestmark = pytest.mark.flow


def test_a_flow_run_without_a_plan_shows_its_findings(tmp_path: Path, lake_url: str, prefect_server: str) -> None:
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import ArtifactFilter

    explained: list[Findings] = []
    with pytest.raises(InfeasibleError, match=r"planner\.measurability\.max_uncertainty = 1e-09 um"):
        inspection.run(
            write_cell(tmp_path),
            overrides=["planner.measurability.max_uncertainty=1e-9 um"],
            lake=lake_url,
            out=tmp_path / "out",
            explain=explained.append,
        )
    (found,) = explained
    assert (found.step, found.causes) == ("select_views", {"uncertainty": 50})
    assert (tmp_path / "out" / "findings.html").is_file()
    with get_client(sync_client=True) as client:
        run = client.read_flow_run(found.run_id)  # type: ignore[arg-type]
        artifacts = client.read_artifacts(artifact_filter=ArtifactFilter(flow_run_id={"any_": [found.run_id]}))
    assert run.state is not None and run.state.is_failed()
    (page,) = [each for each in artifacts if each.key == "inspection-findings"]  # Prefect lists its own beside it
    assert "| uncertainty | 50 |" in str(page.data)


def test_neither_a_broken_explanation_nor_a_broken_server_hides_the_error(
    tmp_path: Path, lake_url: str, prefect_server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flows import findings, inspection_flow

    def broken(*_: object, **__: object) -> None:
        raise OSError("gone")

    monkeypatch.setattr(findings, "_counted", broken)
    monkeypatch.setattr(inspection_flow, "create_markdown_artifact", broken)
    with pytest.raises(InfeasibleError, match=r"planner\.measurability\.max_uncertainty = 1e-09 um") as caught:
        inspection.run(write_cell(tmp_path), overrides=["planner.measurability.max_uncertainty=1e-9 um"], lake=lake_url)
    assert caught.value.__notes__ == [
        "explaining it failed: OSError: gone",
        "showing the findings in Prefect failed: OSError: gone",
    ]
