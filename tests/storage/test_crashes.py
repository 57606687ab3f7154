"""What is left in a local lake after kill -9, full disks, missing permissions and writers that race."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cellwright.errors import LakeError
from storage.lake import Lake
from tests.storage.specimens import recipe, same, tally
from tests.unprivileged import without_privileges

ROOT = Path(__file__).parents[2]

# one process that has imported everything forks the writers: starting Python anew for each would take most of the time
_KILLER = """
import os, signal, sys, time, random
from storage.lake import Lake
from tests.storage.specimens import recipe, tally
lake = Lake(sys.argv[1])
lake.publish(recipe(warm=1).key, tally(1), recipe(warm=1))
random.seed(3)
for attempt in range(14):
    heard, told = os.pipe()
    writer = os.fork()
    if writer == 0:
        number = 0
        while True:
            about = recipe(attempt=attempt, number=number)
            with lake.alone(about.key):
                lake.publish(about.key, tally(*range(number % 40, 4000)), about, {"number": number})
            os.write(told, b"1")
            number += 1
    os.read(heard, 1)  # it is in the middle of its work
    time.sleep(random.uniform(0, 0.06))
    os.kill(writer, signal.SIGKILL)
    os.waitpid(writer, 0)
    os.close(heard), os.close(told)
"""

_RACERS = """
import os, sys, random
from storage.lake import Lake
from tests.storage.specimens import recipe, tally
lake = Lake(sys.argv[1])
racers = []
for racer in range(4):
    pid = os.fork()
    if pid == 0:
        numbers = list(range(25)) * 2
        random.Random(racer).shuffle(numbers)
        try:
            for number in numbers:
                about = recipe(number=number)
                ref = lake.publish(about.key, tally(number // 2), about)
                assert lake.find(about.key) == ref
                lake.load(ref)
        except BaseException as error:
            print(repr(error), flush=True)
            os._exit(1)
        os._exit(0)
    racers.append(pid)
sys.exit(max(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for pid in racers))
"""

_COUNTERS = """
import os, sys, time
from pathlib import Path
from storage.lake import Lake
from tests.storage.specimens import recipe
lake, counter = Lake(sys.argv[1]), Path(sys.argv[1]) / "counter"
counter.write_text("0")
workers = []
for _ in range(4):
    pid = os.fork()
    if pid == 0:
        for _ in range(25):
            with lake.alone(recipe().key):
                counted = int(counter.read_text())
                time.sleep(0.0005)
                counter.write_text(str(counted + 1))
        os._exit(0)
    workers.append(pid)
for pid in workers:
    os.waitpid(pid, 0)
print(counter.read_text())
"""

_HOLDER = """
import sys
from storage.lake import Lake
from tests.storage.specimens import recipe
with Lake(sys.argv[1]).alone(recipe().key):
    print("held", flush=True)
    sys.stdin.read()
"""


def _run(code: str, lake: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code, str(lake)], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.strip()


def test_kill_9_leaves_only_whole_artefacts(tmp_path: Path) -> None:
    _run(_KILLER, tmp_path / "lake")
    lake = Lake(str(tmp_path / "lake"))
    manifests = list(lake.manifests())
    assert len(manifests) >= 15
    assert len(manifests) == len(lake.place.walk("manifests"))
    assert lake.verify() == []
    for manifest in manifests:
        assert lake.find(manifest.key) == manifest.ref
    # a rerun of everything that was under way completes
    for attempt in range(14):
        number = sum(m.about.params.get("attempt") == attempt for m in manifests)
        about = recipe(attempt=attempt, number=number)
        with lake.alone(about.key):
            made = tally(*range(number % 40, 4000))
            assert same(lake.load(lake.publish(about.key, made, about)), made)


def test_writers_of_the_same_keys_do_each_other_no_harm(tmp_path: Path) -> None:
    _run(_RACERS, tmp_path / "lake")
    lake = Lake(str(tmp_path / "lake"))
    assert len(list(lake.manifests())) == 25
    assert len(lake.place.walk("data")) == 13
    assert lake.verify() == []
    assert list((tmp_path / "lake" / ".scratch").iterdir()) == []


def test_alone_keeps_processes_apart(tmp_path: Path) -> None:
    assert _run(_COUNTERS, tmp_path) == "100"
    assert list((tmp_path / ".locks").iterdir()) == []


def test_a_killed_holder_gives_its_lock_back(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _HOLDER, str(tmp_path)], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        holder.kill()
        holder.wait()
        with Lake(str(tmp_path)).alone(recipe().key):
            assert len(list((tmp_path / ".locks").iterdir())) == 1


@pytest.mark.parametrize("failing", range(1, 12))
def test_a_disk_that_is_full_at_any_moment_leaves_nothing_half_written(
    failing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lake = Lake(str(tmp_path))
    old = lake.publish(recipe(old=1).key, tally(7), recipe(old=1))
    calls = 0
    sync = os.fsync

    def fill(handle: int) -> None:
        nonlocal calls
        calls += 1
        if calls == failing:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(handle)

    about = recipe()
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fill)
        if failing <= 9:  # file, folder and parent of content, provenance and manifest
            with pytest.raises(LakeError, match=r"No space left on device \(.* MB free\): free some space"):
                lake.publish(about.key, tally(1), about)
        else:
            lake.publish(about.key, tally(1), about)
            assert calls == 9
    assert list((tmp_path / ".scratch").iterdir()) == []
    assert lake.verify() == []
    assert same(lake.load(old), tally(7))
    assert same(lake.load(lake.publish(about.key, tally(1), about)), tally(1))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mount.returncode:
        pytest.skip("mounting a small disk is not permitted here")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def test_a_full_disk_is_told_with_its_numbers_and_loses_nothing(small_disk: Path) -> None:
    lake = Lake(str(small_disk / "lake"))
    old = lake.publish(recipe(old=1).key, tally(7), recipe(old=1))
    noise = np.random.default_rng(1).integers(-(2**31), 2**31, 1_000_000).astype(np.int32)
    with pytest.raises(LakeError, match=r"No space left on device \(4\.\d MB to write, \d\.\d MB free\)") as caught:
        lake.publish(recipe().key, tally(*noise), recipe())
    assert str(small_disk) in str(caught.value)
    assert "--lake" in str(caught.value)
    assert list((small_disk / "lake" / ".scratch").iterdir()) == []
    assert lake.find(recipe().key) is None
    assert same(lake.load(old), tally(7))
    assert lake.verify() == []


@pytest.fixture
def closed_folder() -> Iterator[Path]:
    """A folder that this process may read and not write."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        Lake(str(folder / "lake")).publish(recipe(old=1).key, tally(7), recipe(old=1))
        for path in [folder, *folder.rglob("*")]:
            path.chmod(path.stat().st_mode & ~0o222)
        try:
            with without_privileges():
                yield folder
        finally:
            for path in [folder, *folder.rglob("*")]:
                path.chmod(0o755)


def test_a_folder_without_write_permission_is_told_before_anything_is_computed(closed_folder: Path) -> None:
    for lake in (Lake(str(closed_folder / "lake")), Lake(str(closed_folder / "new" / "lake"))):
        with (
            pytest.raises(
                LakeError, match="Permission denied: make the folder writable for this user or choose another"
            ),
            lake.alone(recipe().key),
        ):
            pass
        with pytest.raises(LakeError, match="Permission denied"):
            lake.publish(recipe().key, tally(1), recipe())
        with pytest.raises(LakeError, match="Permission denied"):
            lake.record_run("one", {})


def test_a_lake_that_may_only_be_read_can_be_read(closed_folder: Path) -> None:
    lake = Lake(str(closed_folder / "lake"))
    ref = lake.find(recipe(old=1).key)
    assert ref is not None
    assert same(lake.load(ref), tally(7))
    assert lake.verify() == []


def test_a_folder_that_cannot_be_looked_into_is_told(closed_folder: Path) -> None:
    with _as_owner():
        (closed_folder / "lake" / "manifests").chmod(0)
    try:
        with pytest.raises(LakeError, match=r"cannot read .*Permission denied"):
            Lake(str(closed_folder / "lake")).find(recipe(old=1).key)
    finally:
        with _as_owner():
            (closed_folder / "lake" / "manifests").chmod(0o755)


@contextlib.contextmanager
def _as_owner() -> Iterator[None]:
    acting = os.geteuid()
    os.seteuid(os.getuid())
    try:
        yield
    finally:
        os.seteuid(acting)


def test_a_place_that_takes_no_folders_is_told() -> None:
    with pytest.raises(LakeError, match="cannot write /proc/lake"):
        Lake("/proc/lake").publish(recipe().key, tally(1), recipe())
