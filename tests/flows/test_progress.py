"""Progress is one line a stage in a log, bars in a terminal, nothing when a machine reads."""

from __future__ import annotations

import io
import re
import time

from flows.progress import PlainProgress, stage_progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def play(stream: io.StringIO, *, quiet: bool = False) -> str:
    with stage_progress(quiet=quiet, stream=stream) as (watcher, say):
        say("starting [the] server")
        watcher.finished("read_source", cached=True, seconds=0.01)
        watcher.started("follow_sweeps")
        watcher.advanced("follow_sweeps", 0.5)
        watcher.finished("follow_sweeps", cached=False, seconds=4.56)
        watcher.started("select_views")
        watcher.failed("select_views")
        watcher.advanced("unknown", 2.0)
    return stream.getvalue()


LINES = ["starting [the] server", "read_source: cached", "follow_sweeps: 4.56 s", "select_views: failed"]


def test_a_log_gets_one_line_a_stage() -> None:
    assert play(io.StringIO()).splitlines() == LINES


def test_a_log_hears_now_and_then_of_a_stage_that_takes_long() -> None:
    stream = io.StringIO()
    plain = PlainProgress(stream, first_word_s=0.2, next_word_s=0.3)
    with plain.telling():
        plain.started("quick")
        plain.finished("quick", cached=False, seconds=0.01)
        plain.started("long")
        plain.advanced("long", 0.25)
        deadline = time.monotonic() + 20
        while stream.getvalue().count("long") < 2:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        plain.failed("long")
        said = stream.getvalue()
        time.sleep(0.5)
    first, word, again, *_ = said.splitlines()
    assert first == "quick: 0.01 s"
    assert all(re.fullmatch(r"long: under way for \d+ s, 25% done", line) for line in (word, again))
    assert said.splitlines()[-1] == "long: failed"
    assert stream.getvalue() == said


def test_a_terminal_keeps_the_same_lines() -> None:
    shown = play(Terminal())
    assert [line for line in LINES if line in shown] == LINES
    assert "follow_sweeps" in shown


def test_a_machine_gets_nothing() -> None:
    assert play(io.StringIO(), quiet=True) == ""
