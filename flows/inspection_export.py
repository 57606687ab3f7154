"""Write a plan's files into a folder for people: report, recording, trajectory, scan and figures.

Files are replaced one by one, each by writing beside it and renaming. The report gets what belongs to this run: how
long each stage took, and what everything was made from.
"""

from __future__ import annotations

import html
import json
import os
from pathlib import Path

import fsspec

from cellwright.errors import InvalidInputError
from flows.inspection_result import InspectionResult
from schemas.references import Ref
from storage.lake import Lake

_RUN_MARK = "<!--RUN-->"


def export(lake: Lake, result: InspectionResult, folder: Path) -> dict[str, Path]:
    """Write the files and return their paths by what they are.

    Raises:
        InvalidInputError: If the folder cannot be written.
    """
    page = result.report.page.decode().replace(_RUN_MARK, run_section(lake, result))
    contents = {
        "report": ("report.html", page.encode()),
        "recording (Foxglove, Rerun)": ("plan.mcap", _stored(lake, result.refs["recording"], "recording.mcap")),
        "trajectory": ("trajectory.parquet", _stored(lake, result.refs["trajectory"], "states.parquet")),
        "segments": ("segments.parquet", _stored(lake, result.refs["trajectory"], "segments.parquet")),
        "scan": ("scan.parquet", _stored(lake, result.refs["scan"], "points.parquet")),
        "summary": ("summary.json", json.dumps(result.as_json(), indent=2, sort_keys=True).encode()),
        **{f"figure: {name}": (f"{name}.png", picture) for name, picture in result.pictures().items()},
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.values():
            _write(folder / name, content)
    except OSError as error:
        raise InvalidInputError(
            f"cannot write into {folder}: {error.strerror or error}: choose another --out"
        ) from error
    return {what: folder / name for what, (name, _) in contents.items()}


def run_section(lake: Lake, result: InspectionResult) -> str:
    """Return the part of the report that belongs to one run: stage timings and lineage, as HTML."""
    rows = "".join(
        f"<tr><td>{html.escape(record.name)}</td><td>{result.stage_seconds[record.name]:.2f}</td>"
        f"<td>{'from the lake' if record.cached else 'computed'}</td><td>{record.version}</td>"
        f'<td class="words"><code>{record.ref.kind}/{record.ref.digest[:12]}</code></td></tr>'
        for record in result.records
    )
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
        "<h2>Stages</h2><p class='lead'>Seconds that each stage took when it was computed.</p><div class='card'><table>"
        "<tr><th>stage</th><th>seconds</th><th>in this run</th><th>version</th><th class='words'>artefact</th></tr>"
        f"{rows}</table></div><h2>What the trajectory was made from</h2>"
        f"<div class='card'><pre>{html.escape(lines)}</pre></div>"
        f"<p class='lead'>Run {html.escape(result.run_id)}.</p>"
    )


def _stored(lake: Lake, ref: Ref, name: str) -> bytes:
    with fsspec.open(lake.paths(ref)[name], "rb") as stream:
        content: bytes = stream.read()
    return content


def _write(path: Path, content: bytes) -> None:
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(content)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
