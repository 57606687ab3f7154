"""Collision checks as constraints of a layout program, grouped by the small function they are instances of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.solvers.layout.mesh import BASE, BASE_WALLS, HULL, STATIONS, WALL, WALLS, Checks, Mesh
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.symbols import LayoutSymbols, Place
from cellwright.solvers.structured_program import StructuredProgram

if TYPE_CHECKING:
    from cellwright.solvers.layout.nlp import Indices


def add_checks(
    symbols: LayoutSymbols,
    mesh: Mesh,
    checks: Checks,
    program: StructuredProgram,
    at: Indices,
    margins_m: tuple[float, float],
    *,
    lifted: bool = False,
) -> tuple[IntArray, IntArray]:
    """Add all checks, with one margin for motion and one for the layout.

    Return the row of each, motion first, in the order of `Checks`, and lifted spheres (n, 2).
    """
    rows = np.zeros(checks.n_checks, np.int64)
    spheres = np.zeros((0, 2), np.int64)
    left = np.ones(len(checks.motion), bool)
    if lifted:
        chosen, own_rows, spheres = add_lifted_checks(symbols, checks, program, at, margins_m[0])
        rows[chosen] = own_rows
        left[chosen] = False
    motion = checks.motion
    if left.any():
        for chosen, place in _places(checks, at, left):
            groups = _motion_groups(symbols, motion[chosen])
            for group in np.unique(groups, axis=0):
                own = chosen[(groups == group).all(axis=1)]
                rows[own] = _add_motion(symbols, mesh, checks, own, place, program, at, margins_m[0])
    for family in (STATIONS, BASE, WALLS, BASE_WALLS):
        chosen = np.flatnonzero(checks.layout[:, 0] == family)
        if len(chosen):
            _add_layout(symbols, family, checks.layout[:, 1], chosen, program, at, margins_m[1], rows[len(motion) :])
    return rows, spheres


def add_lifted_checks(
    symbols: LayoutSymbols, checks: Checks, program: StructuredProgram, at: Indices, margin_m: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Add checks against hulls at configurations with the spheres' centres as variables of their own.

    The paper's equation (4) has the tool's positions as variables too: kinematics then enter once a configuration
    and not once a check. Return the checks added, their rows, and what the centres are: (row, sphere), (n, 2).
    """
    motion = checks.motion
    chosen = np.flatnonzero((motion[:, 3] == HULL) & (motion[:, 0] == motion[:, 1]))
    spheres, which = np.unique(motion[chosen][:, [0, 4]], axis=0, return_inverse=True)
    problem, geometry = symbols.problem, symbols.geometry
    free = np.full(3 * len(spheres), np.inf)
    centres = program.add_variables("centres", -free, free).reshape(-1, 3)
    for link in np.unique(problem.robot_spheres.link[spheres[:, 1]]).tolist():
        mine = np.flatnonzero(problem.robot_spheres.link[spheres[:, 1]] == link)
        index = np.hstack([at.q[spheres[mine, 0]], np.tile(at.base, (len(mine), 1)), centres[mine]])
        local = problem.robot_spheres.centres[spheres[mine, 1]]
        program.add_constraint(f"centres {link}", symbols.centre(link), index, local, 0.0, 0.0)
    rows = np.zeros(len(chosen), np.int64)
    hull = motion[chosen, 5]
    for station in np.unique(geometry.hull_station[hull]).tolist():
        mine = np.flatnonzero(geometry.hull_station[hull] == station)
        local = symbols.in_station(station, geometry.hull_centres[hull[mine]])
        radii = geometry.hull_radii[hull[mine]] + problem.robot_spheres.radii[motion[chosen[mine], 4]]
        index = np.hstack([centres[which[mine]], np.tile(at.stations[station], (len(mine), 1))])
        constants = np.column_stack([local, radii + problem.clearance_m])
        function = symbols.point_gap(station)
        added = program.add_constraint(f"points {station}", function, index, constants, margin_m, np.inf)
        rows[mine] = added[:, 0]
    return chosen, rows, spheres


def _places(checks: Checks, at: Indices, left: BoolArray) -> list[tuple[IntArray, Place]]:
    """Return which motion checks sit at a configuration, and which between two."""
    at_row = (checks.share == 0.0) | (checks.share == 1.0) | (checks.motion[:, 0] == checks.motion[:, 1])
    between = Place.ARC if len(at.velocity) else Place.LINE
    found = [(np.flatnonzero(at_row & left), Place.ROW), (np.flatnonzero(~at_row & left), between)]
    return [(chosen, place) for chosen, place in found if len(chosen)]


def _motion_groups(symbols: LayoutSymbols, motion: IntArray) -> IntArray:
    """Return what a check's function depends on: what against, link, and station or other link, (n, 3)."""
    link = symbols.problem.robot_spheres.link
    other = np.zeros(len(motion), np.int64)
    hull, wall = motion[:, 3] == HULL, motion[:, 3] == WALL
    other[hull] = symbols.geometry.hull_station[motion[hull, 5]]
    own = ~(hull | wall)
    other[own] = link[motion[own, 5]]
    return np.column_stack([motion[:, 3], link[motion[:, 4]], other])


def _add_motion(
    symbols: LayoutSymbols,
    mesh: Mesh,
    checks: Checks,
    own: IntArray,
    place: Place,
    program: StructuredProgram,
    at: Indices,
    margin_m: float,
) -> IntArray:
    problem = symbols.problem
    motion, share = checks.motion[own], checks.share[own]
    kind, sphere, other = int(motion[0, 3]), motion[:, 4], motion[:, 5]
    link = int(problem.robot_spheres.link[sphere[0]])
    variables, where = _configuration(mesh, motion, share, place, at)
    n = len(own)
    base = np.tile(at.base, (n, 1))
    local, radii = problem.robot_spheres.centres[sphere], problem.robot_spheres.radii[sphere]
    if kind == HULL:
        geometry = symbols.geometry
        station = int(geometry.hull_station[other[0]])
        centres = symbols.in_station(station, geometry.hull_centres[other])
        most = radii + geometry.hull_radii[other] + problem.clearance_m
        constants = np.column_stack([where, local, centres, most])
        index = np.hstack([variables, base, np.tile(at.stations[station], (n, 1))])
        function = symbols.hull_gap(link, station, place)
    elif kind == WALL:
        constants = np.column_stack([where, local, _planes(problem, other, radii + problem.clearance_m)])
        index = np.hstack([variables, base])
        function = symbols.wall_gap(link, place)
    else:
        spheres = problem.robot_spheres
        constants = np.column_stack([where, local, spheres.centres[other], radii + spheres.radii[other]])
        index = variables
        function = symbols.self_gap(link, int(spheres.link[other[0]]), place)
    name = f"motion {kind} {link} {place.value} {program.n_constraints}"
    return program.add_constraint(name, function, index, constants, margin_m, np.inf)[:, 0]


def _configuration(
    mesh: Mesh, motion: IntArray, share: FloatArray, place: Place, at: Indices
) -> tuple[IntArray, FloatArray]:
    """Return the variables (n, k) that the checks' configurations depend on, and where between them they are."""
    before, after = motion[:, 0], motion[:, 1]
    if place is Place.ROW:
        return at.q[np.where(share == 1.0, after, before)], np.zeros((len(motion), 0))
    if place is Place.LINE:
        return np.hstack([at.q[before], at.q[after]]), share[:, None]
    number = motion[:, 2]
    times = at.times[np.array([mesh.segment_time[n][0] for n in number.tolist()])]
    part = np.array([mesh.segment_share[n][0] for n in number.tolist()])
    variables = np.hstack([at.q[before], at.q[after], at.velocity[before], at.velocity[after], times[:, None]])
    return variables, np.column_stack([share, part])


def _add_layout(
    symbols: LayoutSymbols,
    family: int,
    pair: IntArray,
    chosen: IntArray,
    program: StructuredProgram,
    at: Indices,
    margin_m: float,
    rows: IntArray,
) -> None:
    """Add checks of one family, station by station; writes their rows."""
    problem, geometry = symbols.problem, symbols.geometry
    spheres = problem.robot_spheres
    pairs = geometry.pair_families[family][pair[chosen]]
    none = np.zeros(len(pairs), np.int64)
    first = geometry.hull_station[pairs[:, 0]] if family == STATIONS else none
    body = none if family == BASE_WALLS else geometry.hull_station[pairs[:, 1]]
    for one, other in np.unique(np.column_stack([first, body]), axis=0).tolist():
        mine = np.flatnonzero((first == one) & (body == other))
        left, right = pairs[mine, 0], pairs[mine, 1]
        if family == BASE_WALLS:
            constants = np.column_stack([spheres.centres[right], _planes(problem, left, spheres.radii[right])])
            index, function = at.base, symbols.base_wall_gap()
        else:
            centres, radii = symbols.in_station(other, geometry.hull_centres[right]), geometry.hull_radii[right]
        if family == STATIONS:
            owner = symbols.in_station(one, geometry.hull_centres[left])
            constants = np.column_stack([owner, centres, radii + geometry.hull_radii[left] + problem.clearance_m])
            index, function = np.concatenate([at.stations[one], at.stations[other]]), symbols.stations_gap(one, other)
        elif family == BASE:
            most = radii + spheres.radii[left] + problem.clearance_m
            constants = np.column_stack([spheres.centres[left], centres, most])
            index, function = np.concatenate([at.base, at.stations[other]]), symbols.base_gap(other)
        elif family == WALLS:
            constants = np.column_stack([centres, _planes(problem, left, radii)])
            index, function = at.stations[other], symbols.station_wall_gap(other)
        name = f"layout {family} {one} {other}"
        added = program.add_constraint(name, function, np.tile(index, (len(mine), 1)), constants, margin_m, np.inf)
        rows[chosen[mine]] = added[:, 0]


def _planes(problem: LayoutProblem, walls: IntArray, distance_m: FloatArray) -> FloatArray:
    """Return normal and offset (n, 4) of the planes at a distance from walls that centres must not cross."""
    normals = np.array([problem.walls[wall].normal for wall in walls.tolist()])
    offsets = np.array([problem.walls[wall].offset_m for wall in walls.tolist()])
    return np.column_stack([normals, offsets + distance_m])
