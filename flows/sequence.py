"""The flow `sequence`: from tasks at poses to the order, alternatives and verified motion of the robot, and its report.

`plan_sequence` chains the stages and says nothing else; `run` is what command line, studies and tests call.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import tasks
from cellwright.errors import CellwrightError
from flows.caches import use_own_caches
from flows.execution import Watcher, open_lake
from flows.result_folder import prepared, write_files
from flows.run_result import RUN_MARK
from flows.runner import Step, Steps, watched
from flows.sequence_requests import SequenceRequest, sequence_request
from flows.sequence_result import SequenceResult
from schemas.sequence_file import SequenceFile, load_sequence_file
from storage.lake import Lake

KEYS = {
    "start_rad": "robot.start",
    "lower_rad": "robot.lower",
    "upper_rad": "robot.upper",
    "max_velocity_rad_s": "robot.max_velocity",
    "max_acceleration_rad_s2": "robot.max_acceleration",
    "ignored_pairs": "may_touch",
    "clearance_m": "planner.clearance",
    "roadmap_nodes": "planner.roadmap_nodes",
    "max_alternatives": "planner.max_alternatives",
    "end_rad": "planner.end",
    "approach_m": "tasks.approach",
    "n_rotations": "tasks.rotations",
    "payload_kg": "tool.payload.mass",
}
"""The file's key by the field of stage parameters that it fills."""
_FIELD = re.compile(r"(?<![\w.])(" + "|".join(KEYS) + r")(?!\w)")


def run(
    sequence_file: Path | SequenceFile,
    *,
    overrides: Sequence[str] = (),
    lake: str,
    refresh: Collection[str] = frozenset(),
    out: Path | None = None,
    watcher: Watcher | None = None,
    direct: bool = False,
) -> SequenceResult:
    """Find, verify and report the sequence of the tasks in a file.

    Args:
        sequence_file: The sequence file, or what was loaded from it.
        overrides: Settings ``path=value`` laid over it, unless it is loaded.
        lake: Folder or address of the lake.
        refresh: Stages to compute although the lake has them.
        out: Folder for report, recording and figures; nothing is exported if left out.
        watcher: Hears of the stages while they run.
        direct: Run without Prefect, one stage after the other.

    Raises:
        InvalidInputError: If file, tasks or robot are malformed, or the folder cannot be written.
        InfeasibleError: If a task has no alternative, no sequence has motions all the way, or it fails its
            verification.
        LakeError: If the lake fails.
    """
    use_own_caches()
    file = load_sequence_file(sequence_file, overrides) if isinstance(sequence_file, Path) else sequence_file
    request = sequence_request(file)
    try:
        with prepared(out), watched(watcher):
            if direct:
                result = sequence_and_record(request, lake, refresh, run_id=uuid.uuid4().hex, direct=True)
            else:
                from flows.sequence_flow import sequence

                result = sequence(request, lake, sorted(refresh))
    except CellwrightError as error:
        told = in_words_of_the_file(error)
        if told is error:
            raise
        raise told from error
    if out is not None:
        result.files.update(export(open_lake(lake), result, out))
    return result


def in_words_of_the_file(error: CellwrightError) -> CellwrightError:
    """Return an error in which fields of stages are keys of the file; the same error where it names none."""
    text = _FIELD.sub(lambda found: KEYS[found[1]], str(error))
    if text == str(error):
        return error
    told = type(error)(text)
    vars(told).update(vars(error))  # its notes, and the moment at which a sequence fails
    return told


def sequence_and_record(
    request: SequenceRequest, lake_url: str, refresh: Collection[str], *, run_id: str, direct: bool
) -> SequenceResult:
    """Run the chain, write down what the run used, and gather its figures."""
    lake = open_lake(lake_url)
    facts = {"flow": "sequence", "cell": request.name}
    with Steps(lake_url, refresh=refresh, direct=direct, run_id=run_id, facts=facts) as step:
        steps = plan_sequence(step, request)
        result = SequenceResult.of(request.name, lake, run_id, steps, step.records())
    return replace(result, notes=tuple(step.notes))


def plan_sequence(step: Steps, request: SequenceRequest) -> dict[str, Step]:
    """Chain the stages of a sequence; returns the steps by the name of what they make."""
    for note in request.notes:
        step.note(note)
    files = tuple(step(tasks.read_source, source, label=source.name) for source in request.cell_files)
    table = None if request.table is None else step(tasks.read_source, request.table, label="tasks")
    cell = step(tasks.assemble_cell, request.cell, files=files)
    task_list = step(tasks.list_tasks, request.tasks, source=table)
    alternatives = step(tasks.generate_alternatives, request.alternatives, cell=cell, tasks=task_list)
    given: dict[str, Any] = {"cell": cell, "tasks": task_list, "alternatives": alternatives}
    sequence = step(tasks.sequence_tasks, request.sequence, **given)
    verification = step(tasks.verify_sequence, request.verification, **given, sequence=sequence)
    recording = step(tasks.record_sequence, request.recording, cell=cell, sequence=sequence)
    report = step(tasks.write_sequence_report, request.report, **given, sequence=sequence, verification=verification)
    return {**given, "sequence": sequence, "verification": verification, "recording": recording, "report": report}


def export(lake: Lake, result: SequenceResult, folder: Path) -> dict[str, Path]:
    """Write a sequence's files and return their paths by what they are.

    Raises:
        InvalidInputError: If the folder cannot be written.
        LakeError: If the lake has lost a file since the run.
    """
    page = result.report.page.decode().replace(RUN_MARK, result.stages_section() + result.run_line)
    contents = {
        "report": ("report.html", page.encode()),
        "recording (Foxglove, Rerun)": ("sequence.mcap", lake.read(result.refs["recording"], "recording.mcap")),
        "trajectory": ("trajectory.parquet", lake.read(result.refs["sequence"], "states.parquet")),
        "segments": ("segments.parquet", lake.read(result.refs["sequence"], "segments.parquet")),
        "stops": ("stops.parquet", lake.read(result.refs["sequence"], "stops.parquet")),
        "summary": ("summary.json", result.summary_file()),
        **{f"figure: {name}": (f"{name}.png", picture) for name, picture in result.pictures().items()},
    }
    write_files(folder, dict(contents.values()), mark=contents["summary"][0])
    return {what: folder / name for what, (name, _) in contents.items()}
