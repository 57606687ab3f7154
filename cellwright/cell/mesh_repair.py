"""Make one sound triangle mesh of a file's triangles: weld, clean, orient outward, and say what was found.

Corners are welded by exact coordinates, then within a tolerance. Faces are oriented so that neighbours agree, by the
connected components of the orientation double cover of the face graph, which also tells surfaces that cannot be
oriented. Closed bodies are then turned outward by their signed volume, the walls of cavities inward by how many bodies
enclose them (solid angle, van Oosterom & Strackee 1983). An open sheet has no inside: it is turned to face up, away
from the table. All steps are vectorised; a million faces take a few seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import AnyArray, BoolArray, FloatArray, Int32Array, IntArray
from cellwright.cell.mesh_topology import Topology, face_pieces, holes, join_pieces, t_junctions, topology_of
from cellwright.cell.part import used_rows
from cellwright.errors import InvalidInputError

_SHEET_SHARE = 0.3
"""A piece whose area vectors sum to more than this share of its area is a sheet: closed bodies sum to 0, a box
without lid to 0.2, a hemisphere to 0.5, a flat sheet to 1."""
_LEVEL_SHARE = 0.1
"""A sheet that faces up or down by less than this share of its area stands upright: neither side is the upper one."""
_MIN_HEIGHT = 1e-12
"""A face lower than this share of its longest edge has no direction."""


@dataclass(frozen=True, eq=False)
class RepairedMesh:
    """A welded, oriented mesh.

    Attributes:
        vertices: (n, 3) in m.
        faces: (m, 3), outward by the right-hand rule.
        normals: Unit normals of the faces, (m, 3).
        areas: Face areas in m^2, (m,).
        watertight: Whether every edge has as many faces on one side as on the other: a volume is enclosed.
        two_sided: Whether both sides of all faces count as surface: only of sheets whose side cannot be known.
        findings: What was found and mended, in words.
    """

    vertices: FloatArray
    faces: Int32Array
    normals: FloatArray
    areas: FloatArray
    watertight: bool
    two_sided: bool
    findings: tuple[str, ...]


def repair_mesh(vertices: FloatArray, faces: AnyArray, up: FloatArray, weld_tolerance: float) -> RepairedMesh:
    """Weld, clean and orient triangles.

    Args:
        vertices: Finite corners, (n, 3) in m.
        faces: Rows of ``vertices``, (m, 3).
        up: Direction away from the table in the part's frame, (3,).
        weld_tolerance: Corners closer than this become one, m.

    Raises:
        InvalidInputError: If no face with an area is left.
    """
    findings: list[str] = []
    points, corners = weld(vertices, faces, weld_tolerance)
    corners = _without_repeats(corners, findings)
    if len(corners) == 0:
        raise InvalidInputError("no face has an area: the part is smaller than the weld tolerance or flat to a line")
    topology = topology_of(corners)
    piece, flipped, orientable = face_pieces(corners, topology)
    was_consistent = not flipped.any()
    if not was_consistent:
        findings.append(f"turned {np.count_nonzero(flipped)} of {len(corners)} faces so that neighbours agree")
        corners, topology = _flip(corners, flipped), topology.turned(flipped)
    if not orientable.all():
        findings.append(f"{np.count_nonzero(~orientable)} pieces cannot be oriented (like a Moebius strip)")
    shell, orientable = join_pieces(corners, topology, piece, orientable)
    turned, two_sided = _outward(points, corners, shell, orientable, was_consistent, up, findings)
    corners, topology = _flip(corners, turned), topology.turned(turned)
    watertight = _report_edges(points, corners, topology, weld_tolerance, findings)
    areas, normals, flat = _areas_and_normals(points, corners)
    if flat.any():
        findings.append(f"dropped {np.count_nonzero(flat)} faces without area (needles)")
        corners, areas, normals = corners[~flat], areas[~flat], normals[~flat]
    if len(corners) == 0:
        raise InvalidInputError("no face has an area: the part is flat to a line")
    points, corners = _used_only(points, corners)
    extent = (points.max(axis=0) - points.min(axis=0)) * 1e3
    n_pieces = len(orientable)
    findings.insert(
        0,
        f"{extent[0]:.1f} x {extent[1]:.1f} x {extent[2]:.1f} mm, {len(corners)} faces in "
        f"{n_pieces} piece{'s' if n_pieces > 1 else ''}, {'watertight' if watertight else 'not watertight'}",
    )
    return RepairedMesh(points, corners.astype(np.int32), normals, areas, watertight, two_sided, tuple(findings))


def weld(vertices: FloatArray, faces: AnyArray, tolerance: float) -> tuple[FloatArray, IntArray]:
    """Merge corners that coincide, then those within ``tolerance`` (transitively); return vertices and faces.

    The first corner of a cluster stands for all.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    used = used_rows(faces)
    points = np.ascontiguousarray(vertices[used], np.float64) + 0.0  # makes -0.0 equal to 0.0
    first, row = _unique_rows(points)
    points = points[first]
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray") if tolerance > 0 else np.empty((0, 2), int)
    if len(pairs):
        links = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
        _, cluster = connected_components(links, directed=False)
        keep, row_of_point = np.unique(cluster, return_index=True)[1], cluster
        order = np.argsort(keep)
        rank = np.empty(len(keep), np.int64)
        rank[order] = np.arange(len(keep))
        points, row = points[keep[order]], rank[row_of_point][row]
    return points, row[np.searchsorted(used, faces)]


def _unique_rows(points: FloatArray) -> tuple[IntArray, IntArray]:
    """Return first rows of distinct points, in the order of their appearance, and the number of each row's point."""
    bits = points.view(np.uint64)
    mixed = bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= np.bitwise_right_shift(mixed, np.uint64(29))
    mixed = (mixed + bits[:, 1]) * np.uint64(0xBF58476D1CE4E5B9)
    mixed ^= np.bitwise_right_shift(mixed, np.uint64(32))
    mixed = (mixed + bits[:, 2]) * np.uint64(0x94D049BB133111EB)
    _, first, row = np.unique(mixed, return_index=True, return_inverse=True)
    if not np.array_equal(points[first][row], points):  # two points share a hash: sort the points themselves
        _, first, row = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(first), np.int64)
    rank[order] = np.arange(len(first))
    return first[order], rank[row.ravel()]


def _without_repeats(corners: IntArray, findings: list[str]) -> IntArray:
    a, b, c = corners.T
    collapsed = (a == b) | (b == c) | (c == a)
    if collapsed.any():
        findings.append(f"dropped {np.count_nonzero(collapsed)} faces without area (two corners in one place)")
        corners = corners[~collapsed]
    if len(corners) == 0:
        return corners
    _, triple = _unique_rows(np.sort(corners, axis=1).astype(np.float64))
    if triple.max() + 1 == len(corners):
        return corners
    keep = _one_of_each(corners, triple)
    findings.append(f"dropped {np.count_nonzero(~keep)} faces that repeat or cancel another")
    return corners[keep]


def _one_of_each(corners: IntArray, triple: IntArray) -> BoolArray:
    """Choose which of the faces with the same three corners stay.

    Faces that look the same way are one. A face and its reverse are a fold without thickness and both go, for one
    alone would leave a hole; in a sheet that was exported with both sides, the first of each pair stays.
    """
    n_triples = int(triple.max()) + 1
    rolled = np.take_along_axis(corners, (np.argmin(corners, axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    side = np.where(rolled[:, 1] < rolled[:, 2], 1, -1)
    surplus = np.bincount(triple, side, n_triples)
    is_sheet = np.count_nonzero(surplus == 0) > n_triples / 2
    wanted = np.where((surplus == 0) & is_sheet, 1, np.sign(surplus))
    candidates = np.flatnonzero(side == wanted[triple])
    keep = np.zeros(len(corners), bool)
    keep[candidates[np.unique(triple[candidates], return_index=True)[1]]] = True
    return keep


def _flip(corners: IntArray, which: BoolArray) -> IntArray:
    return np.where(which[:, None], corners[:, ::-1], corners)


def _outward(
    points: FloatArray,
    corners: IntArray,
    piece: IntArray,
    orientable: BoolArray,
    was_consistent: bool,
    up: FloatArray,
    findings: list[str],
) -> tuple[BoolArray, bool]:
    """Decide which faces to turn, piece by piece, and whether the mesh counts on both sides."""
    n_pieces = len(orientable)
    origin = points.mean(axis=0)
    a, b, c = (points[corners[:, k]] - origin for k in range(3))
    area_vectors = np.cross(b - a, c - a) / 2
    area = np.bincount(piece, np.linalg.norm(area_vectors, axis=1), n_pieces)
    total = np.stack([np.bincount(piece, area_vectors[:, k], n_pieces) for k in range(3)], axis=1)
    centre = (
        np.stack(
            [
                np.bincount(piece, np.linalg.norm(area_vectors, axis=1) * (a + b + c)[:, k] / 3, n_pieces)
                for k in range(3)
            ],
            axis=1,
        )
        / np.maximum(area, 1e-300)[:, None]
    )
    # relative to the piece's own centre, so that the openings of a nearly closed body weigh little
    volume = np.bincount(piece, np.einsum("ij,ij->i", a - centre[piece], area_vectors) / 3, n_pieces)
    sheet = (np.linalg.norm(total, axis=1) > _SHEET_SHARE * area) | ~orientable
    upward = total @ (up / np.linalg.norm(up))
    level = np.abs(upward) > _LEVEL_SHARE * area
    inside_out = ~sheet & (volume * np.where(_depth(points, corners, piece, ~sheet) % 2 == 0, 1, -1) < 0)
    face_down = sheet & level & (upward < 0)
    if inside_out.any():
        findings.append(f"turned {np.count_nonzero(inside_out)} of {n_pieces} pieces that were inside out")
    if sheet.any():
        n_turned = np.count_nonzero(face_down)
        findings.append(
            f"{np.count_nonzero(sheet)} of {n_pieces} pieces are open sheets: the side that faces away from the table "
            f"is measured{f' ({n_turned} turned)' if n_turned else ''}"
        )
    unknown = sheet & (~orientable | (~level & (not was_consistent)))
    two_sided = bool(sheet.all() and unknown.any())
    if two_sided:
        findings.append("which side of the sheet is its surface cannot be known: both sides count")
    return (inside_out | face_down)[piece], two_sided


def _depth(points: FloatArray, corners: IntArray, piece: IntArray, body: BoolArray) -> IntArray:
    """Count for each piece how many other bodies enclose it."""
    n_pieces = len(body)
    depth = np.zeros(n_pieces, np.int64)
    if np.count_nonzero(body) < 2:
        return depth
    order = np.argsort(piece, kind="stable")
    starts = np.searchsorted(piece[order], np.arange(n_pieces + 1))
    triangles = points[corners[order]]  # (faces, 3, 3)
    low = np.minimum.reduceat(triangles.min(axis=1), starts[:-1])
    high = np.maximum.reduceat(triangles.max(axis=1), starts[:-1])
    for inner in np.flatnonzero(body):
        outer = body & (low <= low[inner]).all(axis=1) & (high >= high[inner]).all(axis=1)
        outer[inner] = False
        for other in np.flatnonzero(outer):
            around = triangles[starts[other] : starts[other + 1]]
            depth[inner] += abs(_winding_number(triangles[starts[inner], 0], around)) > 0.5
    return depth


def _winding_number(point: FloatArray, triangles: FloatArray) -> float:
    a, b, c = (triangles[:, k] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", *pair) for pair in ((a, b), (b, c), (c, a))]
    solid_angle = 2 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return float(solid_angle.sum() / (4 * np.pi))


def _report_edges(
    points: FloatArray, corners: IntArray, topology: Topology, tolerance: float, findings: list[str]
) -> bool:
    """Report holes and non-manifold edges; return whether the mesh is watertight."""
    n_crowded = int(np.count_nonzero(topology.n_faces > 2))
    if n_crowded:
        findings.append(f"{n_crowded} edges are shared by more than two faces (non-manifold)")
    open_edges = topology.edges[topology.n_faces % 2 == 1]
    if len(open_edges):
        n_holes, longest = holes(points, open_edges)
        findings.append(
            f"{len(open_edges)} open edges in {n_holes} loop{'s' if n_holes > 1 else ''} (borders or holes), "
            f"the longest {longest * 1e3:.1f} mm around"
        )
        n_junctions = t_junctions(points, open_edges, max(tolerance, 1e-7))
        if n_junctions:
            findings.append(f"{n_junctions} of the open edges have another vertex on them (T-junctions)")
    return len(open_edges) == 0 and topology.is_balanced(corners)


def _areas_and_normals(points: FloatArray, corners: IntArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    a, b, c = (points[corners[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    doubled = np.linalg.norm(cross, axis=1)
    longest = np.max([np.einsum("ij,ij->i", side, side) for side in (b - a, c - b, a - c)], axis=0)
    flat = doubled <= _MIN_HEIGHT * longest
    normals = cross / np.where(flat, 1.0, doubled)[:, None]
    return doubled / 2, normals, flat


def _used_only(points: FloatArray, corners: IntArray) -> tuple[FloatArray, IntArray]:
    used = used_rows(corners)
    return points[used], np.searchsorted(used, corners)
