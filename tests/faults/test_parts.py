"""A part that is broken, missing or in the wrong unit: one error that says what to mend, or findings."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cellwright.cell.parametric_parts import plate_with_pocket, stl_bytes
from schemas.sources import SourceFile
from tasks.preprocess_mesh import MeshParams, preprocess_mesh
from tasks.read_source import SourceParams, read_source
from tests.faults.bench import MALFORMED, Bench
from tests.small_inspection import write_cell

PLATE = stl_bytes(plate_with_pocket())
PARTS = Path(__file__).parents[3] / "shared" / "data" / "parts"


def ascii_stl(*triangles: tuple[tuple[float, float, float], ...]) -> bytes:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in triangles
    )
    return f"solid part\n{facets}endsolid part\n".encode()


def with_value(value: bytes) -> bytes:
    return PLATE[:96] + value + PLATE[100:]


PLY = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("part.stl", b"", r"part\.stl is empty \(0 bytes\): export it again"),
        ("part.stl", bytes(range(256)) * 20, r"part\.stl is no STL, or is cut off"),
        ("part.stl", PLATE[:700], r"it says 28 faces but holds 12: export"),
        ("part.stl", PLATE[:80] + bytes(4), r"holds no triangles: export"),
        ("part.stl", PLATE[:80] + b"\xff\xff\xff\xff" + PLATE[84:], r"says 4294967295 faces but holds 28"),
        ("part.stl", with_value(b"\x00\x00\xc0\x7f"), r"1 of 84 vertices that are not finite.*: export"),
        ("part.stl", with_value(b"\x00\x00\x80\x7f"), r"1 of 84 vertices that are not finite.*: export"),
        ("part.stl", ascii_stl(((0, 0, 0), (9, 0, 0), (20, 0, 0))), r"no face has an area"),
        ("part.stl", ascii_stl(((5, 5, 5), (5, 5, 5), (5, 5, 5))), r"0 mm long as read in mm"),
        (
            "part.stl",
            ascii_stl(((0, 0, 0), (9, 0, 0), (0, 9, 0)))[:-14],
            r"cut off: it does not end in `endsolid`: export",
        ),
        ("part.obj", b"v 0 0\nv 9 0\nv 0 9\nf 1 2 3\n", r"part\.obj is malformed"),
        ("part.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 0 1 2\n", r"part\.obj, line 4: a face names vertex 0"),
        (
            "part.step",
            b'ISO-10303-21;\n"rubbish\nEND-ISO-10303-21;\n',
            r"part\.step is a malformed STEP file.*: export",
        ),
        ("part.ply", b"rubbish", r"part\.ply is malformed"),
        ("part.ply", PLY + b"end_header\n0 0 0\n9 0 0\n0 9 0\n", r"no triangles \(a point cloud"),
        (
            "part.ply",
            PLY + b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n9 0 0\n0 9 0\n3 0 1 7\n",
            r"a face with vertex 7 but 3 vertices",
        ),
        ("part.obj", b"v 0 0 nan\nv 9 0 0\nv 0 9 0\nf 1 2 3\n", r"1 of 3 vertices that are not finite"),
        ("part.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 9\n", r"part\.obj is malformed"),
        ("part.3mf", b"rubbish", r"part\.3mf is no 3MF file"),
        ("part.step", b"rubbish", r"part\.step is no STEP file"),
        ("part.txt", b"rubbish", r"type '\.txt': use one of \.stl"),
    ],
)
def test_a_malformed_part_is_refused(name: str, content: bytes, says: str, bench: Bench) -> None:
    (bench.folder / name).write_bytes(content)
    assert re.search(says, bench.refused_setting(MALFORMED, f"part.file={name}"))


def test_a_missing_part_is_told_with_file_line_and_key(bench: Bench) -> None:
    cell = write_cell(bench.folder)
    (bench.folder / "plate.stl").unlink()
    said = bench.refused(MALFORMED, cell=cell)
    assert said.startswith(f"{cell}, line 4, part.file: '{bench.folder / 'plate.stl'}' does not exist")


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("part.unit=m", "120 m long as read in m, but a part must be at most 5 m: is the unit mm?"),
        ("part.unit=um", "0.12 mm long as read in um, but a part must be at least 1 mm: is the unit mm?"),
        ("part.scale=500", "60 m long as read in mm, but a part must be at most 5 m"),
        ("part.scale=0.0005", "0.06 mm long as read in mm, but a part must be at least 1 mm"),
        ("part.scale=-1", "must be above 0"),
        ("part.unit=parsec", "is not one of um, mm, cm, m, in, ft"),
    ],
)
def test_a_part_in_the_wrong_unit_is_refused(setting: str, says: str, bench: Bench) -> None:
    assert says in bench.refused_setting(MALFORMED, setting)


@pytest.mark.skipif(not PARTS.is_dir(), reason="../shared/data/parts is not there")
def test_a_busted_mesh_is_read_with_its_findings() -> None:
    source = read_source(params=SourceParams.of(PARTS / "busted.STL"))
    assert preprocess_mesh(source, params=MeshParams()).finding


def test_defects_that_planning_can_live_with_are_findings() -> None:
    o, x, y, z, w = (0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 0.0, 9.0), (9.0, 9.0, 9.0)
    tetrahedron = [(o, y, x), (o, x, z), (o, z, y), (x, y, z)]
    fin, needle = (x, y, w), (o, x, (18.0, 0.0, 0.0))
    source = SourceFile(name="part.stl", content=ascii_stl(*tetrahedron, tetrahedron[0], fin, needle))
    mesh = preprocess_mesh(source, params=MeshParams())
    assert not mesh.watertight
    for defect in ("faces that repeat", "non-manifold", "without area"):
        assert defect in " ".join(mesh.finding)
