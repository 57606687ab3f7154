"""Write a run down in the lake while it lasts: what it has used so far, and how it ended.

The record is what keeps results when the lake is swept, so it is there from the first moment and grows with each
stage that is computed: a run that fails, or is killed, keeps what it had as a finished one does. A killed process
cannot write that it was; its record goes on saying ``running``, and `state_of` looks whether that can be.
"""

from __future__ import annotations

import contextlib
import os
import platform
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwright.errors import CellwrightError, LakeError
from schemas.references import Ref
from schemas.stage import Stage

if TYPE_CHECKING:
    from flows.execution import Outcome
    from storage.lake import Lake


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One step of a run for summaries and for the lake's run record.

    Attributes:
        name: The stage's name, with the step's label if it has one.
        stage: The stage.
        version: The stage's version.
        ref: The artefact.
        cached: Whether the lake had it.
        seconds: Time from asking for it to having it; the waiting for its inputs is not in it.
    """

    name: str
    stage: str
    version: int
    ref: Ref
    cached: bool
    seconds: float

    def as_json(self) -> dict[str, str | int | float | bool]:
        """Return the record as plain values, the reference spelled out."""
        return {
            "name": self.name,
            "stage": self.stage,
            "version": self.version,
            "kind": self.ref.kind,
            "key": self.ref.key,
            "digest": self.ref.digest,
            "cached": self.cached,
            "seconds": round(self.seconds, 6),
        }


class RunRecord:
    """The record of one run; steps report to it from several threads. Without a lake it only remembers."""

    def __init__(self, lake: Lake | None, run_id: str, facts: Mapping[str, Any]) -> None:
        self._lake = lake
        self._run_id = run_id
        self._facts = dict(facts)
        self._steps: dict[str, StepRecord] = {}
        self._state: dict[str, str] = {"state": "running"}
        self._unwritten = False  # the lake has refused the first word of this run, and every one since
        self._lock = threading.Lock()

    def begin(self) -> None:
        """Write down that the run has begun, and where.

        A lake that refuses it may still answer: where it has everything that the run asks for, nothing need be
        written. `making` and `finish` try again.
        """
        self._facts |= {"host": platform.node(), "process": os.getpid(), "process_started": _start_of(os.getpid())}
        with self._lock:
            try:
                self._write()
            except LakeError:
                self._unwritten = True

    def making(self) -> None:
        """Make sure that the run is on record before something is computed whose result could not be kept.

        Raises:
            LakeError: If the lake still cannot be written.
        """
        with self._lock:
            if self._unwritten:
                self._write()
                self._unwritten = False

    def add(self, name: str, stage: Stage, outcome: Outcome) -> None:
        """Take down a step that ended well; the record is written again if the step cost something.

        A step may end after the run has: the record then keeps what became of the run.
        """
        with self._lock:
            self._steps[name] = StepRecord(
                name, stage.name, stage.version, outcome.ref, outcome.cached, outcome.seconds
            )
            if not outcome.cached:
                with contextlib.suppress(LakeError):  # the last write tells; a lost one in between does no harm
                    self._write()

    def of(self, name: str) -> StepRecord | None:
        """Return a step by its name, if it ended well in this process."""
        return self._steps.get(name)

    def steps(self) -> list[StepRecord]:
        """Return the steps that ended well so far."""
        with self._lock:
            return list(self._steps.values())

    def finish(self, steps: Sequence[StepRecord]) -> LakeError | None:
        """Write down that the run is done, with all its steps; return why it is not on record at all, if so.

        Raises:
            LakeError: If the lake has taken the run's beginning but not its end.
        """
        with self._lock:
            self._steps = {step.name: step for step in steps}
            self._state = {"state": "finished"}
            try:
                self._write()
            except LakeError as error:
                if not self._unwritten:
                    raise
                return error
            return None

    def fail(self, error: BaseException, step: str = "") -> None:
        """Write down how the run ended; a lake that cannot be written must not hide the error that ended it."""
        interrupted = not isinstance(error, Exception)  # Ctrl-C, a cancelled flow, the process told to leave
        said = str(error) if isinstance(error, CellwrightError) else f"{type(error).__name__}: {error}".rstrip(": ")
        ended = {"state": "interrupted"} if interrupted else {"state": "failed", "error": said, "failed_step": step}
        with self._lock, contextlib.suppress(LakeError):
            self._state = ended
            self._write()

    def _write(self) -> None:
        if self._lake is not None:
            steps = [step.as_json() for step in self._steps.values()]
            self._lake.record_run(self._run_id, {**self._facts, **self._state, "steps": steps})


def state_of(record: Mapping[str, Any]) -> str:
    """Return ``finished``, ``failed``, ``interrupted`` or ``running``.

    A run that says it is running but whose process is gone was killed: it counts as interrupted. On another machine
    that cannot be seen.
    """
    state = str(record.get("state", "finished"))  # records of earlier versions were written at the end only
    if state == "running" and record.get("host") == platform.node():
        process = record.get("process")
        started = _start_of(process) if isinstance(process, int) else ""
        return "running" if started and started == record.get("process_started") else "interrupted"
    return state


def _start_of(process: int) -> str:
    """Return what tells a living process from another one that had or will have its number; empty if it is gone."""
    try:
        status = Path(f"/proc/{process}/stat").read_text()
        return status.rpartition(")")[2].split()[19]  # its start in ticks since the machine's; see proc(5)
    except (OSError, IndexError):
        pass
    try:
        os.kill(process, 0)
    except (OSError, OverflowError):
        return ""
    return "alive" if process > 0 else ""
