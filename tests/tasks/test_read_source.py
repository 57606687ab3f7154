from pathlib import Path

import pytest

from cellwright.errors import InvalidInputError
from tasks.read_source import SourceParams, read_source
from tests.tasks.goldens import check_golden


def test_a_file_is_read_byte_for_byte(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    path.write_bytes(bytes(range(256)))
    source = read_source(params=SourceParams.of(path))
    assert (source.name, source.content) == ("part.stl", bytes(range(256)))


def test_the_result_is_the_one_of_this_version(tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(bytes(range(256)))
    check_golden(read_source, read_source(params=SourceParams.of(tmp_path / "part.stl")))


def test_the_key_is_the_content_and_not_the_place(tmp_path: Path) -> None:
    (tmp_path / "moved").mkdir()
    for folder in (tmp_path, tmp_path / "moved"):
        (folder / "part.stl").write_bytes(b"same")
    here, there = SourceParams.of(tmp_path / "part.stl"), SourceParams.of(tmp_path / "moved" / "part.stl")
    assert here.path != there.path
    assert here.canonical() == there.canonical()
    (tmp_path / "part.stl").write_bytes(b"other")
    assert SourceParams.of(tmp_path / "part.stl").canonical() != there.canonical()


def test_a_file_that_changes_between_keying_and_reading_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    path.write_bytes(b"before")
    params = SourceParams.of(path)
    path.write_bytes(b"after")
    with pytest.raises(InvalidInputError, match=r"changed while it was in use .*: run again"):
        read_source(params=params)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("missing", "does not exist"),
        ("folder", "is a folder"),
        ("empty", r"is empty \(0 bytes\)"),
        ("file/x", "cannot"),
    ],
)
def test_what_is_no_file_is_refused_with_its_path(tmp_path: Path, kind: str, words: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty").touch()
    (tmp_path / "file").write_bytes(b"x")
    path = tmp_path / kind
    with pytest.raises(InvalidInputError, match=words) as caught:
        SourceParams.of(path)
    assert str(path) in str(caught.value)
    if kind != "file/x":
        with pytest.raises(InvalidInputError, match=words):
            read_source(params=SourceParams(path=str(path), name="x", sha256="0" * 64))
