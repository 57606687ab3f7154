"""The library's objects behind the artefacts of sweeps: what blocks their sight, and where they run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import BoolArray, Int32Array
from cellwright.errors import InvalidInputError
from schemas.part import PartMesh, Surroundings
from schemas.views import Reachability, Viewpoints

if TYPE_CHECKING:
    from cellwright.cell.occlusion import Occluder
    from cellwright.solvers.coverage import CandidatePieces
    from cellwright.solvers.measurability import Sweeps


def occluder_of(mesh: PartMesh, surroundings: Surroundings) -> Occluder:
    """Return the part and what stands around it as what blocks sight, in the frame `part`; the part's faces first.

    Raises:
        InvalidInputError: If the mesh has vertices that are not finite.
    """
    from cellwright.cell.bodies import Mesh
    from cellwright.cell.occlusion import Occluder

    return Occluder(Mesh(mesh.vertices_m, mesh.faces), Mesh(surroundings.vertices_m, surroundings.faces))


def candidate_sweeps(viewpoints: Viewpoints) -> Sweeps:
    """Return all candidates with unlimited travel, row for row."""
    from cellwright.cell.transforms import rotation_from_quaternion
    from cellwright.solvers.measurability import Sweeps

    return Sweeps.untrimmed(viewpoints.position_m, rotation_from_quaternion(viewpoints.quaternion))


def piece_sweeps(viewpoints: Viewpoints, reachability: Reachability, rows: Int32Array) -> Sweeps:
    """Return executable pieces as sweeps; ``rows`` (sweeps,) are rows of the pieces."""
    from cellwright.cell.transforms import rotation_from_quaternion
    from cellwright.solvers.measurability import Sweeps

    view = reachability.view[rows]
    return Sweeps(
        viewpoints.position_m[view],
        rotation_from_quaternion(viewpoints.quaternion[view]),
        reachability.start_m[rows],
        reachability.end_m[rows],
    )


def candidate_pieces(
    viewpoints: Viewpoints, reachability: Reachability, selected: BoolArray, connected: BoolArray
) -> CandidatePieces:
    """Return all candidates with their executable pieces; ``selected`` and ``connected`` are of the views, (views,).

    Raises:
        InvalidInputError: If the reachability is that of other viewpoints.
    """
    from cellwright.solvers.coverage import CandidatePieces

    n_views = len(viewpoints.sample)
    if len(reachability.outcome) != n_views:
        raise InvalidInputError(
            f"there are {n_views} viewpoints but reachability knows {len(reachability.outcome)}: give those that it "
            "was made of"
        )
    return CandidatePieces(
        sweeps=candidate_sweeps(viewpoints),
        view=reachability.view,
        start=reachability.start_m,
        end=reachability.end_m,
        outcome=reachability.outcome,
        blocked_by=reachability.blocked_by,
        selected=selected,
        connected=connected,
    )


def best_pieces(reachability: Reachability, views: Int32Array | None = None) -> Int32Array:
    """Return the row of the first piece of each view that has one, by view; ``views`` limits them to these."""
    found, rows = np.unique(reachability.view, return_index=True)
    kept = np.ones(len(found), bool) if views is None else np.isin(found, views)
    return rows[kept].astype(np.int32)
