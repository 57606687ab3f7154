"""What `kill -9`, damaged files and rivals do to a run: a rerun completes and ends in the same artefacts."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import tasks
from cellwright.errors import CellwrightError, LakeError
from storage.lake import Lake
from tests.every_stage import run_every_stage, write_cell_with_gaps

PROJECT = Path(__file__).parents[1]
pytestmark = pytest.mark.xdist_group("crashes")  # all share one undisturbed run

_KILLER = """
import importlib, json, os, pkgutil, signal, sys, threading
from pathlib import Path
import coal, fcl, matplotlib.pyplot, numba, pinocchio, scipy.spatial, trimesh  # once for all the children
import cellwright.cell, cellwright.solvers
from flows import execution
from storage.lake import Lake
from tests.every_stage import run_every_stage

for package in (cellwright.cell, cellwright.solvers):
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def run_and_die(cell, lake, stage, delay_s, syncs):
    computed, publish, sync = execution._computed, Lake.publish, os.fsync

    def computing(which, *arguments):
        if which.name == stage and not syncs:
            threading.Timer(delay_s, die).start()
        return computed(which, *arguments)

    def publishing(self, key, artefact, about, provenance=None):
        left = syncs

        def count(handle):
            nonlocal left
            left -= 1
            if left < 0:
                die()
            sync(handle)

        if about.stage == stage:
            if not syncs:
                die()  # it was quicker than the timer
            os.fsync = count
        return publish(self, key, artefact, about, provenance)

    execution._computed, Lake.publish = computing, publishing
    run_every_stage(Path(cell), lake)


signals = []
for lake, stage, delay_s, syncs in json.loads(sys.argv[2]):
    child = os.fork()
    if child == 0:
        try:
            run_and_die(sys.argv[1], lake, stage, delay_s, syncs)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    signals.append(os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0)
print(json.dumps(signals))
"""


class Undisturbed:
    """A finished run of every stage: its cell file, its lake, and the digest of each artefact."""

    def __init__(self, folder: Path) -> None:
        self.cell = write_cell_with_gaps(folder)
        self.lake = folder / "lake"
        self.digests = self.run(self.lake)

    def run(self, lake: Path) -> dict[str, str]:
        """Run what the lake does not have and return the digests by key."""
        return run_every_stage(self.cell, str(lake))

    def lake_without(self, stage: str, copy: Path) -> Path:
        """Return a copy of the lake in which all that a stage made is missing."""
        shutil.copytree(self.lake, copy)
        manifests = list(Lake(str(copy)).manifests())
        kept = {manifest.folder for manifest in manifests if manifest.about.stage != stage}
        for manifest in manifests:
            if manifest.about.stage == stage:
                (copy / "manifests" / manifest.key[:2] / f"{manifest.key}.json").unlink()
                if manifest.folder not in kept:  # two stages may have made the same
                    shutil.rmtree(copy / manifest.folder, ignore_errors=True)
        return copy

    def seconds(self, stage: str) -> float:
        """Return how long a stage took."""
        lake = Lake(str(self.lake))
        ours = [manifest.key for manifest in lake.manifests() if manifest.about.stage == stage]
        return float((lake.provenance(ours[0]) or {})["seconds"])


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    return Undisturbed(tmp_path_factory.mktemp("undisturbed"))


def test_the_run_has_every_stage(undisturbed: Undisturbed) -> None:
    assert {manifest.about.stage for manifest in Lake(str(undisturbed.lake)).manifests()} == set(tasks.STAGES)


def check_kills(undisturbed: Undisturbed, kills: list[tuple[str, int]], folder: Path) -> None:
    """Kill a run in each stage: half-way through its work, or after some syncs of its files; then rerun."""
    lakes = [undisturbed.lake_without(stage, folder / f"{stage}{syncs}") for stage, syncs in kills]
    jobs = [(str(lake), stage, 0.5 * undisturbed.seconds(stage), syncs) for lake, (stage, syncs) in zip(lakes, kills)]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _KILLER, str(undisturbed.cell), json.dumps(jobs)],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == [9] * len(kills)
    for lake, (stage, syncs) in zip(lakes, kills):
        assert Lake(str(lake)).verify() == [], (stage, syncs)
        assert undisturbed.run(lake) == undisturbed.digests, (stage, syncs)
        assert Lake(str(lake)).verify() == [], (stage, syncs)


def test_a_run_killed_in_a_stage_completes_when_it_is_run_again(undisturbed: Undisturbed, tmp_path: Path) -> None:
    check_kills(
        undisturbed, [("read_source", 2), ("sample_surface", 0), ("stitch_sweeps", 0), ("record_plan", 6)], tmp_path
    )


@pytest.mark.slow
@pytest.mark.parametrize("stage", sorted(tasks.STAGES))
def test_a_run_killed_anywhere_in_any_stage_completes_when_it_is_run_again(
    stage: str, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    check_kills(undisturbed, [(stage, 0), *((stage, syncs) for syncs in (1, 2, 4, 6, 8))], tmp_path)


def oldest(lake: Path, kind: str) -> list[Path]:
    """Return the files of the first artefact of its kind, which every run reads even if nothing is computed."""
    return list(min((lake / "data" / kind).iterdir(), key=lambda folder: folder.stat().st_mtime_ns).iterdir())


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "delete"])
def test_a_damaged_artefact_is_told_or_made_again_and_the_result_is_the_same(
    damage: str, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    lake = tmp_path / "lake"
    shutil.copytree(undisturbed.lake, lake)
    for path in [*oldest(lake, "cell-model"), *oldest(lake, "part-mesh")]:
        content = bytearray(path.read_bytes())
        path.chmod(0o644)
        if damage == "flip":
            content[len(content) // 2] ^= 1
            path.write_bytes(content)
        elif damage == "delete":
            path.unlink()
        else:
            path.write_bytes(content[: 0 if damage == "empty" else len(content) // 2])
    told = 0
    while True:
        try:
            found = undisturbed.run(lake)
            break
        except LakeError as error:
            told += 1
            assert "run again to make it anew" in str(error)
            assert told <= 2
    assert found == undisturbed.digests
    assert told == (2 if damage == "flip" else 0)  # one for each kind; a wrong size is seen without reading
    assert Lake(str(lake)).verify() == []


def test_damaged_manifests_are_made_again(undisturbed: Undisturbed, tmp_path: Path) -> None:
    for number, content in enumerate((b"", b"{", b"\x00\xff", b"[]", b'{"kind": 1}')):
        lake = tmp_path / str(number)
        shutil.copytree(undisturbed.lake, lake)
        for manifest in list(Lake(str(lake)).manifests()):
            if manifest.about.stage in ("preprocess_mesh", "sample_viewpoints"):
                path = lake / "manifests" / manifest.key[:2] / f"{manifest.key}.json"
                path.chmod(0o644)
                path.write_bytes(content)
        assert undisturbed.run(lake) == undisturbed.digests
        assert Lake(str(lake)).verify() == []


def test_two_runs_at_once_on_one_lake_end_in_the_same_artefacts(undisturbed: Undisturbed, tmp_path: Path) -> None:
    lake = undisturbed.lake_without("preprocess_mesh", tmp_path / "lake")
    for manifest in list(Lake(str(lake)).manifests()):
        if manifest.about.stage in ("sample_viewpoints", "measure_samples", "simulate_scan", "measure_coverage"):
            (lake / "manifests" / manifest.key[:2] / f"{manifest.key}.json").unlink()
    found: list[dict[str, str] | CellwrightError] = []

    def run() -> None:
        try:
            found.append(undisturbed.run(lake))
        except CellwrightError as error:
            found.append(error)

    runs = [threading.Thread(target=run) for _ in range(3)]
    for each in runs:
        each.start()
    for each in runs:
        each.join()
    assert found == [undisturbed.digests] * 3
    assert Lake(str(lake)).verify() == []
