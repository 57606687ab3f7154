import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.parametric_parts import box, grooved_cylinder, stl_bytes
from cellwright.cell.part import METRES_PER_UNIT, read_mesh, resting_pose, size_fault, top_height
from cellwright.cell.transforms import apply, pose, rotation_from_rpy
from cellwright.errors import InvalidInputError

PARTS = Path(__file__).parents[4] / "shared" / "data" / "parts"
CUBE = box((0.02, 0.03, 0.04))


def text_stl(mesh: Mesh) -> bytes:
    lines = ["solid vertex of the part"]
    for triangle in mesh.vertices[mesh.faces] * 1e3:
        lines += ["facet normal 0 0 0", " outer loop"]
        lines += [f"  vertex {x!r} {y!r} {z!r}" for x, y, z in triangle.tolist()]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, "endsolid"]).encode()


def text_ply(mesh: Mesh, vertices: FloatArray | None = None) -> bytes:
    points = mesh.vertices * 1e3 if vertices is None else vertices
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(points)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    rows = [" ".join(map(repr, row)) for row in points.tolist()]
    return "\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()), ""]).encode()


def text_obj(mesh: Mesh) -> bytes:
    rows = [f"v {x} {y} {z}" for x, y, z in (mesh.vertices * 1e3).tolist()]
    return "\n".join([*rows, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()), ""]).encode()


def packed_3mf(mesh: Mesh, unit: str = "millimeter") -> bytes:
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in (mesh.vertices * 1e3).tolist())
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces.tolist())
    model = (
        f'<?xml version="1.0"?><model unit="{unit}" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1" type="model">'
        f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object></resources>"
        '<build><item objectid="1"/></build></model>'
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("3D/3dmodel.model", model)
    return packed.getvalue()


FACET = (
    b"solid plate\n facet normal 0 0 1e-0\n  outer loop\n   vertex 0 0 0\n   vertex 1.5e0 0 0\n   vertex 0 +1 0\n"
    b"  endloop\n endfacet\nendsolid plate\n"
)
TWO_AND_FOUR = (
    b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\nfacet normal 0 0 1\n"
    b"outer loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nvertex 0 0 1\nendloop\nendfacet\nendsolid x\n"
)


def corners_of(vertices: FloatArray, faces: object) -> FloatArray:
    return np.sort(vertices[faces].reshape(-1, 9).round(4), axis=0)  # type: ignore[index]


@pytest.mark.parametrize(
    ("name", "content", "unit"),
    [
        ("part.stl", stl_bytes(CUBE), None),
        ("part.STL", text_stl(CUBE), None),
        ("part.ply", text_ply(CUBE), None),
        ("part.obj", text_obj(CUBE), None),
        ("part.3mf", packed_3mf(CUBE), "mm"),
        ("part.3mf", packed_3mf(CUBE, "inch"), "in"),
        ("part.3mf", packed_3mf(CUBE, "micron"), "um"),
    ],
)
def test_every_file_type_gives_the_same_triangles(name: str, content: bytes, unit: str | None) -> None:
    mesh = read_mesh(name, content)
    assert mesh.unit == unit
    assert np.allclose(corners_of(mesh.vertices, mesh.faces), corners_of(CUBE.vertices * 1e3, CUBE.faces), atol=1e-4)


def test_a_binary_stl_may_begin_with_the_word_that_marks_text() -> None:
    content = b"solid" + stl_bytes(CUBE)[5:]
    assert len(read_mesh("part.stl", content).faces) == 12
    assert len(read_mesh("part.stl", content + b"trailing").faces) == 12


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("part.stl", b"", "is empty (0 bytes)"),
        ("part.doc", b"x", "unknown type '.doc': use stl"),
        ("part.stl", bytes(range(256)) * 40, "no STL, or is cut off"),
        ("part.stl", b"short", "no STL, or is cut off: it says 0 faces but holds 0"),
        ("part.stl", stl_bytes(CUBE)[:-20], "it says 12 faces but holds 11"),
        ("part.stl", stl_bytes(CUBE)[:80] + bytes(4), "holds no triangles"),
        ("part.stl", text_stl(CUBE)[:300], "is cut off: it does not end in `endsolid`"),
        ("part.stl", text_stl(CUBE).replace(b"endsolid", b""), "is cut off: it does not end in `endsolid`"),
        ("part.stl", FACET.replace(b"endfacet", b""), "1 of 1 facets are not three corners"),
        ("part.stl", FACET.replace(b"endloop", b"vertex 1 1 1 endloop"), "1 facets but 4 corners"),
        ("part.stl", TWO_AND_FOUR, "2 of 2 facets are not three corners"),
        ("part.stl", FACET.decode().encode("utf-16"), "is text in UTF-16"),
        ("part.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "is malformed"),
        ("part.obj", b"v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n", "is malformed"),
        ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 0/1 2/1 3/1\n", "line 5: a face names vertex 0"),
        ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0", "line 4: a face names vertex 0"),
        ("part.stl", text_stl(CUBE).replace(b"10.0", b"1.0.0", 1), "malformed vertex"),
        ("part.ply", bytes(range(256)) * 40, "is malformed"),
        ("part.ply", text_ply(CUBE)[:-40], "is cut off: it says 12 faces but holds"),
        ("part.ply", text_ply(Mesh(CUBE.vertices, CUBE.faces[:0])), "holds no triangles"),
        ("part.ply", text_ply(CUBE).replace(b"\n3 0", b"\n3 99", 1), "part.ply"),
        ("part.obj", bytes(range(256)) * 40, "part.obj"),
        ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "part.obj"),
        ("part.3mf", b"not a zip", "no 3MF file"),
        ("part.3mf", packed_3mf(CUBE)[:-30], "part.3mf"),
        ("part.step", b"garbage", "no STEP file"),
        ("part.stp", b"ISO-10303-21;\nHEADER;\n", "is cut off"),
    ],
)
def test_malformed_files_are_refused_with_their_name_and_a_mend(name: str, content: bytes, words: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        read_mesh(name, content)
    assert str(caught.value).startswith(name)
    assert words in str(caught.value)
    assert ": " in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        FACET,
        b"\xef\xbb\xbf" + FACET,
        FACET.replace(b"\n", b"\r\n"),
        FACET.replace(b"\n", b"\r"),
        FACET.replace(b"solid plate", b"solid facet normal vertex 1 2 3", 1),
        FACET.replace(b"endsolid plate", b"endsolid vertex 1 2 3"),
        FACET.upper(),
    ],
)
def test_text_stl_is_read_whatever_its_line_ends_mark_and_name(content: bytes) -> None:
    mesh = read_mesh("part.stl", content)
    assert mesh.vertices[mesh.faces].tolist() == [[[0, 0, 0], [1.5, 0, 0], [0, 1, 0]]]


def test_solids_behind_one_another_are_one_part() -> None:
    assert len(read_mesh("part.stl", FACET + FACET).faces) == 2


def test_a_malformed_step_file_is_refused_in_its_readers_words_and_without_a_word_on_the_terminal(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(InvalidInputError, match=r"holds no shape \(ERR StepFile"):
        read_mesh("part.step", b'ISO-10303-21;\n"nonsense\nEND-ISO-10303-21;\n')
    assert capfd.readouterr() == ("", "")


def test_a_step_file_without_a_shape_is_refused() -> None:
    empty = b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n"
    with pytest.raises(InvalidInputError, match="malformed STEP file, or holds no shape"):
        read_mesh("part.stp", empty)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_vertices_that_are_not_finite_are_counted_and_named(bad: float) -> None:
    vertices = CUBE.vertices * 1e3
    vertices[5, 1] = bad
    with pytest.raises(InvalidInputError, match=r"part.ply has 1 of 8 vertices that are not finite.* vertex 5"):
        read_mesh("part.ply", text_ply(CUBE, vertices))


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=300), st.sampled_from(["stl", "ply", "obj", "3mf"]), st.booleans())
def test_no_bytes_make_a_reader_fall_over(content: bytes, suffix: str, with_head: bool) -> None:
    heads = {"stl": b"solid x\nfacet normal 0 0 0\n", "ply": text_ply(CUBE)[:150], "obj": b"v 1 2 3\nf 1 1 1\n"}
    whole = (heads.get(suffix, b"PK\x03\x04") if with_head else b"") + content
    try:
        mesh = read_mesh(f"part.{suffix}", whole)
    except InvalidInputError as error:
        assert f"part.{suffix}" in str(error)
    else:
        assert len(mesh.faces) > 0


@pytest.mark.parametrize(
    ("size", "unit", "words"),
    [
        (60.0, "m", "part is 60 m long as read in m, but a part must be at most 5 m: is the unit mm? Write unit: mm"),
        (0.06e-3, "mm", "part is 0.06 mm long as read in mm, but a part must be at least 1 mm: is the unit m?"),
        (1e-9, "mm", "check unit and scale"),
    ],
)
def test_an_implausible_size_names_the_unit_that_was_meant(size: float, unit: str, words: str) -> None:
    fault = size_fault("part", size, unit, 1e-3, 5.0)
    assert fault is not None and words in fault


@settings(deadline=None)
@given(st.floats(0.011, 1.9), st.sampled_from(sorted(METRES_PER_UNIT)), st.sampled_from(sorted(METRES_PER_UNIT)))
def test_the_guessed_unit_gives_a_plausible_size(size: float, meant: str, written: str) -> None:
    wrong = size / METRES_PER_UNIT[meant] * METRES_PER_UNIT[written]
    fault = size_fault("part", wrong, written, 1e-3, 5.0)
    if fault is None:
        assert 1e-3 <= wrong <= 5.0
    else:
        guess = fault.rsplit("Write unit: ", 1)[1]
        assert 0.01 <= wrong / METRES_PER_UNIT[written] * METRES_PER_UNIT[guess] <= 2.0


@settings(deadline=None)
@given(st.tuples(*[st.floats(-3.1, 3.1)] * 3), st.tuples(*[st.floats(-1, 1)] * 3))
def test_a_resting_part_touches_the_table_in_the_middle_of_its_footprint(
    rpy: tuple[float, float, float], place: tuple[float, float, float]
) -> None:
    mesh = grooved_cylinder(n_segments=24)
    rotation = rotation_from_rpy(*rpy)
    T_world_part = resting_pose(mesh.vertices, rotation, place[:2], place[2])
    standing = apply(T_world_part, mesh.vertices)
    assert standing[:, 2].min() == pytest.approx(place[2], abs=1e-12)
    assert (standing.min(axis=0) + standing.max(axis=0))[:2] / 2 == pytest.approx(place[:2], abs=1e-12)
    assert np.allclose(T_world_part[:3, :3], rotation)


@pytest.mark.parametrize(
    "shape",
    [Box((0.1, 0.2, 0.3)), Cylinder(0.1, 0.3), Sphere(0.1), Capsule(0.05, 0.2), Mesh(CUBE.vertices, CUBE.faces)],
)
def test_the_top_of_a_body_is_its_highest_point(shape: Shape) -> None:
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    around = 2 * np.pi * rng.random(200_000)
    rim = np.column_stack([np.cos(around), np.sin(around), np.zeros(200_000)])
    ends = np.array([0, 0, 1.0]) * rng.choice([-0.5, 0.5], 200_000)[:, None]
    match shape:
        case Box(size):
            surface = rng.choice([-0.5, 0.5], (64, 3)) * size
        case Cylinder(radius, length):
            surface = rim * radius + ends * length
        case Capsule(radius, length):
            surface = directions * radius + ends * length
        case Sphere(radius):
            surface = directions * radius
        case Mesh(vertices):
            surface = vertices
    for _ in range(5):
        T = pose(rng.normal(size=3), rotation_from_rpy(*rng.uniform(-3, 3, 3)))
        assert top_height(shape, T) == pytest.approx(apply(T, surface)[:, 2].max(), abs=2e-5)


@pytest.mark.skipif(not PARTS.is_dir(), reason="public part files are not there")
def test_step_carries_its_unit_and_is_finely_tessellated() -> None:
    inches = read_mesh("NIST_MBE_PMI_3.stp", (PARTS / "NIST_MBE_PMI_3.stp").read_bytes())
    assert inches.unit == "m"
    assert np.ptp(inches.vertices, axis=0) == pytest.approx([0.4854, 0.3008, 0.1625], abs=1e-4)
    round_plate = read_mesh("NIST_MBE_PMI_11.stp", (PARTS / "NIST_MBE_PMI_11.stp").read_bytes())
    radius = np.hypot(round_plate.vertices[:, 0], round_plate.vertices[:, 1]).max()
    assert radius == pytest.approx(0.0315, abs=2e-5)


def test_damaged_files_are_read_or_refused_but_never_crash() -> None:
    rng = np.random.default_rng(0)
    whole = {
        "stl": [stl_bytes(CUBE), text_stl(CUBE)],
        "ply": [text_ply(CUBE)],
        "obj": [text_obj(CUBE)],
        "3mf": [packed_3mf(CUBE)],
    }
    n_refused = 0
    for _ in range(1500):
        suffix = str(rng.choice(list(whole)))
        content = bytearray(whole[suffix][rng.integers(len(whole[suffix]))])
        for place in rng.integers(0, len(content), rng.integers(1, 5)):
            kind = rng.integers(3)
            if kind == 0 and place < len(content):
                content[place] = rng.integers(256)
            elif kind == 1:
                del content[place : place + int(rng.integers(1, 30))]
            else:
                content[place:place] = rng.integers(0, 256, 4, np.uint8).tobytes()
        try:
            assert len(read_mesh(f"part.{suffix}", bytes(content)).faces) > 0
        except InvalidInputError:
            n_refused += 1
    assert 100 < n_refused < 1500
