"""How the faces of a triangle mesh hang together: edges, connected pieces, orientation, holes, T-junctions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array, IntArray


@dataclass(frozen=True, eq=False)
class Topology:
    """The edges of a mesh.

    Attributes:
        edges: Vertex pairs, the lower first, (edges, 2).
        n_faces: Faces at each edge, (edges,).
        edge_of_side: Edge of each side of each face, (faces, 3); side ``k`` runs from corner ``k`` to the next.
    """

    edges: IntArray
    n_faces: IntArray
    edge_of_side: IntArray

    def turned(self, which: BoolArray) -> Topology:
        """Return the topology after the corners of some faces (faces,) were reversed."""
        sides = np.where(which[:, None], self.edge_of_side[:, [1, 0, 2]], self.edge_of_side)
        return Topology(self.edges, self.n_faces, sides)

    def is_balanced(self, corners: IntArray) -> bool:
        """Tell whether every edge is run through as often in one direction as in the other."""
        forward = np.where(corners < np.roll(corners, -1, axis=1), 1, -1)  # (faces, 3)
        balance = np.bincount(self.edge_of_side.ravel(), forward.ravel(), len(self.edges))
        return not balance.any()


def is_closed(faces: IntArray) -> bool:
    """Whether every edge of welded faces (m, 3) belongs to an even number of them: then a mesh has an inside."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return bool((counts % 2 == 0).all())


def is_closed_and_oriented(faces: IntArray | Int32Array) -> bool:
    """Whether every edge of the faces (m, 3) belongs to two of them that run along it in opposite directions.

    Stricter than `is_closed`: the normals then tell inside from outside everywhere.
    """
    directed = np.asarray(faces, np.int64)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    n = int(directed.max(initial=0)) + 1
    forward = np.sort(directed[:, 0] * n + directed[:, 1])
    backward = np.sort(directed[:, 1] * n + directed[:, 0])
    return bool(len(forward)) and bool((np.diff(forward) > 0).all()) and bool((forward == backward).all())


def topology_of(corners: IntArray) -> Topology:
    """Collect the edges of faces (faces, 3) that have three different corners each."""
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)  # (faces * 3, 2)
    low, high = ends.min(axis=1), ends.max(axis=1)
    span = int(high.max()) + 1
    codes, edge_of_side, n_faces = np.unique(low * span + high, return_inverse=True, return_counts=True)
    return Topology(np.stack([codes // span, codes % span], axis=1), n_faces, edge_of_side.reshape(-1, 3))


def face_pieces(corners: IntArray, topology: Topology) -> tuple[IntArray, BoolArray, BoolArray]:
    """Split a mesh into pieces connected over edges with exactly two faces, and orient each piece.

    In the double cover of the face graph each face appears twice, as it is and turned; neighbours that run through
    their common edge in opposite directions agree. A piece whose two covers are connected cannot be oriented.

    Returns:
        Piece of each face (faces,), whether the face must be turned to agree with the majority of its piece
        (faces,), whether the piece can be oriented (pieces,).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n_faces = len(corners)
    sides = np.argsort(topology.edge_of_side.ravel(), kind="stable")
    starts = np.cumsum(topology.n_faces) - topology.n_faces
    shared = starts[topology.n_faces == 2]
    first, second = sides[shared], sides[shared + 1]
    forward = (corners < np.roll(corners, -1, axis=1)).ravel()
    agree = forward[first] != forward[second]
    f, g = first // 3, second // 3
    n_links = len(f)
    links = coo_array((np.ones(n_links, bool), (f, g)), shape=(n_faces, n_faces))
    n_pieces, piece = connected_components(links, directed=False)
    piece = piece.astype(np.int64)
    if agree.all():
        return piece, np.zeros(n_faces, bool), np.ones(n_pieces, bool)
    cross = np.where(agree, 0, n_faces)
    rows = np.concatenate([f, f + n_faces])
    columns = np.concatenate([g + cross, g + (n_faces - cross)])
    cover = coo_array((np.ones(2 * n_links, bool), (rows, columns)), shape=(2 * n_faces, 2 * n_faces))
    _, label = connected_components(cover, directed=False)
    as_is, turned = label[:n_faces], label[n_faces:]
    orientable = np.ones(n_pieces, bool)
    orientable[piece[as_is == turned]] = False
    root = np.unique(piece, return_index=True)[1]
    flipped = as_is != as_is[root][piece]
    flipped &= orientable[piece]
    # turn the smaller half of each piece
    majority = np.bincount(piece, flipped, n_pieces) * 2 > np.bincount(piece, minlength=n_pieces)
    return piece, flipped ^ (majority & orientable)[piece], orientable


def join_pieces(
    corners: IntArray, topology: Topology, piece: IntArray, orientable: BoolArray
) -> tuple[IntArray, BoolArray]:
    """Join pieces that non-manifold edges have cut apart into shells, where their orientations agree.

    Pieces that are closed by themselves (two cubes that touch along an edge) stay apart.

    Returns:
        Shell of each face (faces,), whether the shell can be oriented (shells,).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n_pieces = len(orientable)
    sides = topology.edge_of_side.ravel()
    piece_of_side = np.repeat(piece, 3)
    uses, n_uses = np.unique(sides * n_pieces + piece_of_side, return_counts=True)
    is_open = np.zeros(n_pieces, bool)
    is_open[uses[n_uses % 2 == 1] % n_pieces] = True
    forward = np.where(corners < np.roll(corners, -1, axis=1), 1, -1).ravel()
    balance = np.bincount(sides, forward, len(topology.edges))
    joins = (topology.n_faces > 2) & (balance == 0)
    at = joins[sides] & is_open[piece_of_side]
    links = coo_array(
        (np.ones(np.count_nonzero(at), bool), (piece_of_side[at], n_pieces + sides[at])),
        shape=(n_pieces + len(topology.edges),) * 2,
    )
    label = connected_components(links, directed=False)[1][:n_pieces]
    _, shell_of_piece = np.unique(label, return_inverse=True)
    can_orient = np.ones(int(shell_of_piece.max()) + 1, bool)
    can_orient[shell_of_piece[~orientable]] = False
    return shell_of_piece[piece], can_orient


def holes(points: FloatArray, open_edges: IntArray) -> tuple[int, float]:
    """Count the connected chains of open edges (edges, 2), and return the length of the longest, m."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vertices, ends = np.unique(open_edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    links = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(len(vertices),) * 2)
    n_holes, hole = connected_components(links, directed=False)
    lengths = np.linalg.norm(points[open_edges[:, 0]] - points[open_edges[:, 1]], axis=1)
    return int(n_holes), float(np.bincount(hole[ends[:, 0]], lengths).max())


def t_junctions(points: FloatArray, open_edges: IntArray, tolerance: float) -> int:
    """Count the open edges (edges, 2) that have the end of another open edge between their own ends."""
    from scipy.spatial import cKDTree

    vertices = np.unique(open_edges)
    tree = cKDTree(points[vertices])
    a, b = points[open_edges[:, 0]], points[open_edges[:, 1]]
    half = np.linalg.norm(b - a, axis=1) / 2
    near = tree.query_ball_point((a + b) / 2, half)
    edge = np.repeat(np.arange(len(open_edges)), [len(found) for found in near])
    if len(edge) == 0:
        return 0
    vertex = vertices[np.concatenate([np.asarray(found, np.int64) for found in near])]
    along = (b - a)[edge] / (2 * half[edge])[:, None]
    offset = points[vertex] - a[edge]
    travel = np.einsum("ij,ij->i", offset, along)
    distance = np.linalg.norm(offset - travel[:, None] * along, axis=1)
    on = (distance <= tolerance) & (travel > tolerance) & (travel < 2 * half[edge] - tolerance)
    return len(np.unique(edge[on]))
