from __future__ import annotations

from pathlib import Path

from cellwright.kernel_cache import discard_stale_kernels


def package(folder: Path) -> Path:
    (folder / "inner" / "__pycache__").mkdir(parents=True)
    (folder / "inner" / "callee.py").write_text("@njit\ndef f(): ...\n")
    (folder / "inner" / "caller.py").write_text("@njit\ndef g(): ...\n")
    (folder / "inner" / "__pycache__" / "caller.f.nbi").write_text("index")
    (folder / "inner" / "__pycache__" / "caller.f.1.nbc").write_text("code")
    return folder


def test_unchanged_sources_keep_their_kernels(tmp_path: Path) -> None:
    folder = package(tmp_path)
    discard_stale_kernels(folder)
    compiled = folder / "inner" / "__pycache__" / "caller.f.nbi"
    compiled.write_text("index")
    assert discard_stale_kernels(folder) == 0
    assert compiled.exists()


def test_a_changed_callee_discards_the_kernels_of_its_caller(tmp_path: Path) -> None:
    folder = package(tmp_path)
    discard_stale_kernels(folder)
    compiled = folder / "inner" / "__pycache__" / "caller.f.nbi"
    compiled.write_text("index")
    (folder / "inner" / "callee.py").write_text("@njit\ndef f(): return 2\n")
    assert discard_stale_kernels(folder) == 1
    assert not compiled.exists()


def test_a_cache_of_unknown_age_is_discarded(tmp_path: Path) -> None:
    assert discard_stale_kernels(package(tmp_path)) == 2
    assert not list(tmp_path.rglob("*.nb?"))


def test_modules_without_kernels_may_change(tmp_path: Path) -> None:
    folder = package(tmp_path)
    discard_stale_kernels(folder)
    compiled = folder / "inner" / "__pycache__" / "caller.f.nbi"
    compiled.write_text("index")
    (folder / "inner" / "words.py").write_text("TEXT = 'new'\n")
    assert discard_stale_kernels(folder) == 0
    assert compiled.exists()
