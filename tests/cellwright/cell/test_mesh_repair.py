import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import AnyArray, FloatArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.mesh_repair import RepairedMesh, repair_mesh, weld
from cellwright.cell.parametric_parts import box, grooved_cylinder, plate_with_pocket
from cellwright.errors import InvalidInputError

UP = np.array([0.0, 0.0, 1.0])
TOLERANCE = 1e-6


def repaired(mesh: Mesh, faces: AnyArray | None = None, up: FloatArray = UP) -> RepairedMesh:
    return repair_mesh(mesh.vertices, mesh.faces if faces is None else faces, up, TOLERANCE)


def volume(mesh: RepairedMesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def merged(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts)]).astype(np.int32),
    )


def soup(mesh: Mesh) -> Mesh:
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    return Mesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))


def moved(mesh: Mesh, *by: float) -> Mesh:
    return Mesh(mesh.vertices + np.array(by), mesh.faces)


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def sheet(n: int = 6, size: float = 0.1) -> Mesh:
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), 0.01 * np.sin(40 * x.ravel())])
    row = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (row[:-1, :-1], row[1:, :-1], row[1:, 1:], row[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Mesh(vertices, faces.astype(np.int32))


def words(mesh: RepairedMesh) -> str:
    return "\n".join(mesh.findings)


@pytest.mark.parametrize("mesh", [box((0.1, 0.2, 0.3)), plate_with_pocket(), grooved_cylinder(n_segments=20)])
def test_a_triangle_soup_becomes_one_watertight_piece(mesh: Mesh) -> None:
    found = repaired(soup(mesh))
    assert found.watertight and not found.two_sided
    assert len(found.vertices) == len(mesh.vertices)
    assert len(found.findings) == 1 and "in 1 piece, watertight" in found.findings[0]
    assert volume(found) == pytest.approx(volume(repaired(mesh)), rel=1e-12)
    assert found.areas.sum() * 1e6 == pytest.approx(repaired(mesh).areas.sum() * 1e6)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_however_faces_are_turned_and_shuffled_they_end_up_outward(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    mesh = plate_with_pocket()
    faces = rng.permutation(mesh.faces, axis=0)
    which = rng.random(len(faces)) < share
    faces[which] = faces[which][:, ::-1]
    found = repaired(mesh, faces)
    assert volume(found) == pytest.approx(0.12 * 0.08 * 0.02 - 0.06 * 0.04 * 0.012, rel=1e-9)
    assert found.watertight
    assert ("so that neighbours agree" in words(found)) == (which.any() and not which.all())


def test_normals_are_unit_outward_and_areas_exact() -> None:
    found = repaired(turned(box((0.1, 0.2, 0.3))))
    assert np.allclose(np.linalg.norm(found.normals, axis=1), 1, atol=1e-15)
    middle = found.vertices[found.faces].mean(axis=1) - found.vertices.mean(axis=0)
    assert (np.einsum("ij,ij->i", middle, found.normals) > 0).all()
    assert found.areas.sum() == pytest.approx(2 * (0.02 + 0.03 + 0.06))
    assert "turned 1 of 1 pieces that were inside out" in words(found)


def test_bodies_turn_outward_and_walls_of_cavities_inward() -> None:
    outer, cavity, island = box((0.3, 0.3, 0.3)), moved(box((0.2, 0.2, 0.2)), 0, 0, 0.05), box((0.05, 0.05, 0.05))
    island, beside = moved(island, 0, 0, 0.1), moved(box((0.1, 0.1, 0.1)), 0.5, 0, 0)
    for variant in (
        merged(outer, cavity, island, beside),
        merged(turned(outer), turned(cavity), island, turned(beside)),
        merged(turned(outer), cavity, turned(island), beside),
    ):
        found = repaired(variant)
        assert volume(found) == pytest.approx(0.3**3 - 0.2**3 + 0.05**3 + 0.1**3)
        assert found.watertight
        assert "in 4 pieces" in found.findings[0]


def test_two_bodies_that_touch_along_an_edge_are_turned_apart() -> None:
    found = repaired(merged(box((0.1, 0.1, 0.1)), turned(moved(box((0.1, 0.1, 0.1)), 0.1, 0.1, 0))))
    assert "1 edges are shared by more than two faces (non-manifold)" in words(found)
    assert volume(found) == pytest.approx(2 * 0.1**3)
    assert found.watertight


def test_near_corners_are_welded_and_far_ones_are_not() -> None:
    mesh = soup(box((0.1, 0.1, 0.1)))
    rng = np.random.default_rng(1)
    near = Mesh(mesh.vertices + rng.uniform(-2e-7, 2e-7, mesh.vertices.shape), mesh.faces)
    assert repaired(near).watertight
    far = Mesh(mesh.vertices + rng.uniform(-2e-5, 2e-5, mesh.vertices.shape), mesh.faces)
    assert not repaired(far).watertight


@settings(deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_welding_keeps_positions_within_the_tolerance_and_shapes(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.integers(0, 4, (n, 3)).astype(float) * np.array([1.0, -1.0, 1.0])
    faces = rng.integers(0, n, (n, 3))
    points, corners = weld(vertices, faces, 1e-9)
    assert np.array_equal(points[corners], vertices[faces])
    assert len(np.unique(points, axis=0)) == len(points) == len(np.unique(vertices[faces].reshape(-1, 3), axis=0))


def test_degenerate_and_repeated_faces_are_dropped_and_counted() -> None:
    mesh = box((0.1, 0.1, 0.1))
    faces = np.concatenate([mesh.faces, mesh.faces[:3, [1, 2, 0]], [[0, 0, 1], [2, 2, 2]]])
    found = repaired(mesh, faces)
    assert len(found.faces) == 12 and found.watertight
    assert "dropped 2 faces without area" in words(found)
    assert "dropped 3 faces that repeat or cancel another" in words(found)


def test_a_fold_without_thickness_goes_and_a_sheet_with_both_sides_keeps_one() -> None:
    mesh = box((0.1, 0.1, 0.1))
    fin = Mesh(np.concatenate([mesh.vertices, [[0.2, 0.0, 0.0]]]), mesh.faces)
    folded = repaired(fin, np.concatenate([mesh.faces, [[0, 1, 8], [8, 1, 0]]]))
    assert len(folded.faces) == 12 and folded.watertight
    both = sheet()
    kept = repaired(both, np.concatenate([both.faces, both.faces[:, ::-1]]))
    assert len(kept.faces) == len(both.faces)
    assert (kept.normals[:, 2] > 0).all()


def test_needles_are_dropped_without_opening_the_mesh() -> None:
    mesh = box((0.1, 0.1, 0.1))
    vertices = np.concatenate([mesh.vertices, [(mesh.vertices[2] + mesh.vertices[0]) / 2]])
    faces = mesh.faces.tolist()
    one = next(face for face in faces if {0, 2} <= set(face))
    faces.remove(one)
    apex = next(corner for corner in one if corner not in (0, 2))
    a, b = (one[(one.index(apex) + k) % 3] for k in (1, 2))
    faces += [[apex, a, 8], [apex, 8, b], [a, b, 8]]  # the last lies flat in the edge
    found = repaired(Mesh(vertices, np.array(faces, np.int32)))
    assert found.watertight
    assert "dropped 1 faces without area (needles)" in words(found)
    assert np.isfinite(found.normals).all()


def test_holes_and_t_junctions_are_reported_with_counts() -> None:
    mesh = box((0.1, 0.1, 0.1))
    open_box = repaired(mesh, mesh.faces[2:])
    assert not open_box.watertight and not open_box.two_sided
    assert "4 open edges in 1 loop" in words(open_box) and "400.0 mm around" in words(open_box)
    assert volume_sign_is_outward(open_box)
    vertices = np.concatenate([mesh.vertices, [(mesh.vertices[0] + mesh.vertices[2]) / 2]])
    faces = mesh.faces.tolist()
    one = next(face for face in faces if {0, 2} <= set(face))
    faces.remove(one)
    apex = next(corner for corner in one if corner not in (0, 2))
    a, b = (one[(one.index(apex) + k) % 3] for k in (1, 2))
    split = repaired(Mesh(vertices, np.array([*faces, [apex, a, 8], [apex, 8, b]], np.int32)))
    assert "1 of the open edges have another vertex on them (T-junctions)" in words(split)


def volume_sign_is_outward(mesh: RepairedMesh) -> bool:
    middle = mesh.vertices[mesh.faces].mean(axis=1) - np.array([0, 0, 0.05])
    return bool((np.einsum("ij,ij->i", middle, mesh.normals) > 0).all())


def test_an_open_sheet_faces_away_from_the_table() -> None:
    for mesh in (sheet(), turned(sheet())):
        found = repaired(mesh)
        assert not found.watertight and not found.two_sided
        assert (found.normals[:, 2] > 0).all()
        assert "open sheets: the side that faces away from the table is measured" in words(found)
        below = repaired(mesh, up=-UP)
        assert (below.normals[:, 2] < 0).all()


def test_an_upright_sheet_keeps_its_side_if_it_has_one_and_counts_twice_if_not() -> None:
    sideways = np.array([0.0, 1.0, 0.0])
    mesh = sheet()
    consistent = repaired(mesh, up=sideways)
    assert not consistent.two_sided
    assert np.array_equal(consistent.normals, repaired(mesh).normals)
    mixed = mesh.faces.copy()
    mixed[::3] = mixed[::3, ::-1]
    unknown = repaired(mesh, mixed, up=sideways)
    assert unknown.two_sided
    assert "both sides count" in words(unknown)


def test_a_moebius_strip_counts_on_both_sides() -> None:
    n = 40
    turn = 2 * np.pi * np.arange(n) / n
    across = np.stack([np.cos(turn / 2) * np.cos(turn), np.cos(turn / 2) * np.sin(turn), np.sin(turn / 2)], axis=1)
    middle = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    vertices = np.concatenate([middle - 0.2 * across, middle + 0.2 * across]) * 0.1
    faces = []
    for k in range(n):
        a, b = k, n + k
        c, d = ((k + 1), n + k + 1) if k < n - 1 else (n, 0)
        faces += [[a, c, d], [a, d, b]]
    found = repaired(Mesh(vertices, np.array(faces, np.int32)))
    assert "cannot be oriented" in words(found)
    assert found.two_sided


def test_what_has_no_area_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="no face has an area"):
        repair_mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), UP, TOLERANCE)
    line = np.array([[0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]])
    with pytest.raises(InvalidInputError, match="flat to a line"):
        repair_mesh(line, np.array([[0, 1, 2]]), UP, TOLERANCE)


def test_the_input_is_left_alone() -> None:
    mesh = turned(box((0.1, 0.1, 0.1)))
    before = mesh.vertices.copy(), mesh.faces.copy()
    repaired(mesh)
    assert np.array_equal(mesh.vertices, before[0]) and np.array_equal(mesh.faces, before[1])


@settings(max_examples=300, deadline=None)
@given(st.integers(3, 9), st.integers(1, 14), st.integers(0, 2**32 - 1))
def test_any_triangles_give_a_sound_mesh_or_the_error(n: int, n_faces: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.integers(0, 3, (n, 3)) * 0.1
    try:
        found = repair_mesh(vertices, rng.integers(0, n, (n_faces, 3)), UP, TOLERANCE)
    except InvalidInputError:
        return
    assert (found.areas > 0).all()
    assert np.allclose(np.linalg.norm(found.normals, axis=1), 1)
    assert len(np.unique(found.vertices, axis=0)) == len(found.vertices) == found.faces.max() + 1
    assert len(np.unique(np.sort(found.faces, axis=1), axis=0)) == len(found.faces)
    if found.watertight and "needles" not in words(found):
        runs: dict[tuple[int, int], int] = {}
        for face in found.faces.tolist():
            for a, b in zip(face, face[1:] + face[:1]):
                runs[min(a, b), max(a, b)] = runs.get((min(a, b), max(a, b)), 0) + (1 if a < b else -1)
        assert not any(runs.values())
        assert volume(found) >= -1e-15 or "non-manifold" in words(found)
