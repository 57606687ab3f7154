"""Write a plan's files into a folder for people: report, recording, trajectory, scan and figures.

The report gets what belongs to this run: how
long each stage took, and what everything was made from.
"""

from __future__ import annotations

import html
from pathlib import Path

from flows.findings import FILES
from flows.inspection_result import InspectionResult
from flows.result_folder import write_files
from flows.run_result import RUN_MARK
from storage.lake import Lake


def export(lake: Lake, result: InspectionResult, folder: Path) -> dict[str, Path]:
    """Write the files and return their paths by what they are.

    Raises:
        InvalidInputError: If the folder cannot be written.
        LakeError: If the lake has lost a file since the run.
    """
    page = result.report.page.decode().replace(RUN_MARK, run_section(lake, result))
    contents = {
        "report": ("report.html", page.encode()),
        "recording (Foxglove, Rerun)": ("plan.mcap", lake.read(result.refs["recording"], "recording.mcap")),
        "trajectory": ("trajectory.parquet", lake.read(result.refs["trajectory"], "states.parquet")),
        "segments": ("segments.parquet", lake.read(result.refs["trajectory"], "segments.parquet")),
        "scan": ("scan.parquet", lake.read(result.refs["scan"], "points.parquet")),
        "summary": ("summary.json", result.summary_file()),
        **{f"figure: {name}": (f"{name}.png", picture) for name, picture in result.pictures().items()},
    }
    write_files(folder, dict(contents.values()), mark=contents["summary"][0], gone=FILES)  # no findings beside a plan
    return {what: folder / name for what, (name, _) in contents.items()}


def run_section(lake: Lake, result: InspectionResult) -> str:
    """Return the part of the report that belongs to one run: stage timings and lineage, as HTML."""
    lines = "\n".join(
        f"{'  ' * ancestor.depth}{ancestor.name or 'trajectory'}: "
        + (
            f"{ancestor.manifest.kind}/{ancestor.digest[:12]} by {ancestor.manifest.about.stage} "
            f"version {ancestor.manifest.about.version}"
            if ancestor.manifest
            else f"{ancestor.digest[:12]}, not in the lake any more"
        )
        for ancestor in lake.lineage(result.refs["trajectory"])
    )
    return (
        f"{result.stages_section()}<h2>What the trajectory was made from</h2><div class='card'><details><summary>"
        "Every artefact behind it, back to the files; each stands below what was made from it"
        f"</summary><pre>{html.escape(lines)}</pre></details></div>{result.run_line}"
    )
