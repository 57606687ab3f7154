"""Holes inside a covered surface: found where a dense grid finds them, and nowhere else."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import trimesh

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.parametric_parts import box
from cellwright.solvers.spheres.body import SphereBody, sphere_body
from cellwright.solvers.spheres.certificate import prove_surface
from cellwright.solvers.spheres.metrics import union_gaps
from cellwright.solvers.spheres.voids import find_voids


def mesh_of(solid: Any) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def voids(body: SphereBody, centres: FloatArray, radii: FloatArray) -> FloatArray:
    assert prove_surface(body.triangles, centres, radii, leaf=1e-3, margin=1e-6).covered
    return find_voids(centres, radii, grid=body.grid, tree=body.tree, shell=body.shell, leaf=1e-3, margin=1e-6)


CUBE = sphere_body(box((1.0, 1.0, 1.0)))
EDGE = 1.0 / np.sqrt(3.0)
"""Edge of the cube in units of its diagonal."""
LATTICE = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))) * EDGE / 3
SKIN = LATTICE[np.abs(LATTICE).max(axis=1) > 0]


@pytest.mark.parametrize("share", [0.90, 0.95, 1.0, 1.05, 1.15, 1.155, 1.16, 1.2])
def test_the_hole_in_the_middle_of_a_cube_is_found_until_its_neighbours_close_it(share: float) -> None:
    # 26 balls about the outer cells of a 3 x 3 x 3 lattice; they hold the surface from 0.87 of a cell on
    radii = np.full(26, share * EDGE / 3)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 61) * EDGE] * 3, indexing="ij"), -1).reshape(-1, 3)
    open_points = grid[union_gaps(grid, SKIN, radii) > 0.0]
    found = voids(CUBE, SKIN, radii)
    if len(open_points):
        assert len(found)
        assert np.linalg.norm(found[:, :3], axis=1).min() < 0.02
    if share > 1.001:
        assert not len(open_points)
        assert not len(found)
    # with the middle ball there is nothing to find
    assert not len(voids(CUBE, LATTICE, np.append(radii, share * EDGE / 3)[np.r_[:13, 26, 13:26]]))


def test_a_hole_as_small_as_a_thousandth_is_found() -> None:
    radii = np.full(26, EDGE / 3)
    for share in (0.999, 0.9999):
        assert len(voids(CUBE, SKIN, radii * share))


def test_a_cavity_counts_as_inside() -> None:
    outer, inner = trimesh.creation.box(extents=(1, 1, 1)), trimesh.creation.box(extents=(0.5, 0.5, 0.5))
    inner.invert()
    body = sphere_body(mesh_of(trimesh.util.concatenate([outer, inner])))
    assert body.shell is None
    assert body.encloses
    radii = np.full(26, 0.95 * EDGE / 3)
    assert len(voids(body, SKIN, radii))
    assert not len(voids(body, LATTICE, np.full(27, 0.95 * EDGE / 3)))


def test_a_room_outside_the_body_needs_no_sphere() -> None:
    # a box without lid, and spheres on its walls that leave its room open: it is not inside
    ring = trimesh.creation.annulus(r_min=0.35, r_max=0.5, height=0.4)
    body = sphere_body(mesh_of(ring))
    unit = body.unit
    angle = 2 * np.pi * np.arange(16) / 16
    around = np.column_stack([0.425 * np.cos(angle), 0.425 * np.sin(angle), np.zeros(16)])
    layers = np.concatenate([around + np.array([0, 0, z]) for z in (-0.14, 0.0, 0.14)]) / unit
    # lids above and below close the room for the spheres, though not for the body
    lid = np.array([[x, y, z] for z in (-0.33, 0.33) for x in (-0.2, 0, 0.2) for y in (-0.2, 0, 0.2)]) / unit
    centres = np.concatenate([layers, lid])
    radii = np.concatenate([np.full(48, 0.15), np.full(18, 0.23)]) / unit
    middle = np.zeros((1, 3))
    assert union_gaps(middle, centres, radii)[0] > 0.05
    assert not len(voids(body, centres, radii))
    filled = sphere_body(mesh_of(trimesh.creation.cylinder(radius=0.5, height=0.4)))
    radii[:48] = 0.16 / unit
    assert len(find_voids(
        centres, radii, grid=filled.grid, tree=filled.tree, shell=filled.shell, leaf=1e-3, margin=1e-6
    ))  # fmt: skip
