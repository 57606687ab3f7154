"""The nonlinear program of a layout: design joints, configurations and times in one problem (Baumgaertner 2025, (4)).

With joint speeds constant over a segment the robot's model is linear: ``|q[n+1] - q[n]| <= v * T / N``; times are
variables, not step lengths. Tool poses at approach knots are equations (hard) or, for the paper's form, a tracking cost
(soft). Collisions enter as the checks that are asked for, at any point between two configurations, with elastic slack
at a price, so that a program with an impossible check still has a solution that says which one and by how much.

`build_layout_nlp` is pure; the `StructuredProgram` it returns can be looked at before it is solved.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.layout.cost_terms import add_extra_cost, knot_seconds
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import Checks, Mesh
from cellwright.solvers.layout.problem import LayoutProblem, TargetKind
from cellwright.solvers.layout.program_checks import add_checks
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.structured_program import CompiledProgram, StructuredProgram

SLACK_COST = 30.0
"""Seconds that a metre of elastic slack costs: far above what a metre can save, so slack stays zero where it can."""
MARGIN_M = 5e-4
"""Checks keep this much more than the clearance, which pays for what bends between them and for Ipopt's tolerance."""
CONTINUITY = 0.7
"""Largest joint motion (rad or m) between two knots of an untimed approach: farther is another branch."""
_LEAST_TIME = 1e-4


@dataclass(frozen=True, eq=False)
class LayoutPoint:
    """Values of a program's variables.

    Attributes:
        design: (n_design,).
        q: (n_configs, joints).
        times: (n_times,) in s.
        velocity: As shares of the joints' limits, (n_configs, joints) for the second order, else (0, joints).
        slack: One a check, in m.
    """

    design: FloatArray
    q: FloatArray
    times: FloatArray
    velocity: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    slack: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class NLPResult:
    """What Ipopt returned: the point, its objective, status, iterations, and the largest violation of a constraint."""

    point: LayoutPoint
    objective: float
    status: str
    iterations: int
    violation: float


@dataclass(frozen=True, eq=False)
class LayoutNLP:
    """A layout program and which of its variables are what.

    Attributes:
        mesh, checks: What it was built for.
        program: Constraints and cost; its variables are named design, q, velocity, times, slack, and total (the
            cycle's time) where the extra cost is a mean over it.
        geometry: Of its problem.
        check_rows: Row of g of each check.
        spheres: Row and robot sphere of each centre that is a variable, (n, 2).
        order: 1: joint speeds are limited; 2: accelerations too.
    """

    geometry: LayoutGeometry
    mesh: Mesh
    checks: Checks
    program: StructuredProgram
    check_rows: IntArray
    spheres: IntArray
    order: int = 1

    def pack(self, point: LayoutPoint) -> FloatArray:
        """Return x at a point; slack is zero."""
        x = np.zeros(self.program.n_variables)
        parts = self.program.variables
        x[parts["design"]] = point.design
        x[parts["q"]] = point.q.ravel()
        x[parts["times"]] = point.times
        if "total" in parts:
            approaches = sum(seconds.sum() for _, seconds in knot_seconds(self.geometry.problem, self.mesh))
            x[parts["total"]] = point.times.sum() + approaches
        if self.order == 2:
            x[parts["velocity"]] = point.velocity.ravel()
        if len(self.spheres):
            base = self.geometry.problem.base_pose(point.design)
            centres = self.geometry.robot_world(base, point.q[self.spheres[:, 0]])
            x[parts["centres"]] = centres[np.arange(len(centres)), self.spheres[:, 1]].ravel()
        return x

    def unpack(self, x: FloatArray) -> LayoutPoint:
        """Return the point at x."""
        parts = self.program.variables
        q = x[parts["q"]].reshape(self.mesh.n_configs, -1)
        velocity = x[parts["velocity"]].reshape(-1, q.shape[1])
        return LayoutPoint(x[parts["design"]], q, x[parts["times"]], velocity, x[parts["slack"]])


@dataclass(frozen=True, eq=False)
class Indices:
    """Where the variables of a layout program are: design (n_design,), q and velocity (n_configs, joints), times."""

    design: IntArray
    q: IntArray
    velocity: IntArray
    times: IntArray
    base: IntArray
    stations: tuple[IntArray, ...]


def build_layout_nlp(
    symbols: LayoutSymbols,
    mesh: Mesh,
    checks: Checks,
    *,
    order: int = 1,
    tracking: float | None = None,
    slack_cost: float = SLACK_COST,
    margin_m: float = MARGIN_M,
    motion_margin_m: float | None = None,
    lifted: bool = False,
    pinned: FloatArray | None = None,
    pinned_design: FloatArray | None = None,
) -> LayoutNLP:
    """Return the program of a mesh with some checks.

    ``order`` 2 limits accelerations. With ``tracking`` the tool poses are met softly: that many seconds a square metre
    and square radian, as in the paper's equation (4); otherwise exactly. An infinite ``slack_cost`` makes checks hard.
    ``pinned`` (n_configs, joints) holds configurations at its values where they are not NaN, ``pinned_design`` the
    design. ``motion_margin_m`` is what the robot's checks keep, if not as much as those among stations. ``lifted``
    gives spheres variables of their own, which pays with many checks a configuration.
    """
    problem = symbols.problem
    program = StructuredProgram()
    at = _add_variables(problem, mesh, program, order, pinned, pinned_design)
    program.add_linear_cost(at.times, 1.0)
    _add_targets(symbols, mesh, program, at, tracking)
    _add_continuity(problem, mesh, program, at)
    if order == 1:
        _add_speeds(problem, mesh, program, at)
    elif mesh.n_segments == 1:
        _add_travel(symbols, mesh, program, at)
    else:
        _add_accelerations(symbols, mesh, program, at)
    margins = (margin_m if motion_margin_m is None else motion_margin_m, margin_m)
    rows, spheres = add_checks(symbols, mesh, checks, program, at, margins, lifted=lifted)
    elastic = len(rows) if np.isfinite(slack_cost) else 0
    slack = program.add_variables("slack", np.zeros(elastic), np.full(elastic, np.inf))
    if elastic:
        program.relax(rows, slack)
        program.add_linear_cost(slack, slack_cost)
    if problem.cost.counts and mesh.visit_rows:
        add_extra_cost(symbols, mesh, program, at, speeds_vary=order == 2 and mesh.n_segments > 1)
    return LayoutNLP(symbols.geometry, mesh, checks, program, rows, spheres, order)


def _add_variables(
    problem: LayoutProblem,
    mesh: Mesh,
    program: StructuredProgram,
    order: int,
    pinned: FloatArray | None,
    pinned_design: FloatArray | None,
) -> Indices:
    arm = problem.arm
    low, high = (problem.lower, problem.upper) if pinned_design is None else (pinned_design, pinned_design)
    design = program.add_variables("design", low, high)
    lower, upper = np.tile(arm.lower, (mesh.n_configs, 1)), np.tile(arm.upper, (mesh.n_configs, 1))
    speed = np.ones((mesh.n_configs if order == 2 else 0, arm.n_joints))
    for rows, knots in zip(mesh.visit_rows, mesh.knots):
        if knots is None:
            lower[rows] = upper[rows] = problem.home_q
        if order == 2 and not (knots is not None and knots.timed):
            speed[rows] = 0.0
    if pinned is not None:
        held = np.isfinite(pinned)
        lower[held] = upper[held] = pinned[held]
    q = program.add_variables("q", lower.ravel(), upper.ravel())
    velocity = program.add_variables("velocity", -speed.ravel(), speed.ravel())
    times = program.add_variables("times", np.full(mesh.n_times, _LEAST_TIME), np.full(mesh.n_times, np.inf))
    parts = problem.design_slices()
    return Indices(
        design,
        q.reshape(-1, arm.n_joints),
        velocity.reshape(-1, arm.n_joints),
        times,
        design[parts[0]],
        tuple(design[part] for part in parts[1:]),
    )


def _add_targets(
    symbols: LayoutSymbols, mesh: Mesh, program: StructuredProgram, at: Indices, tracking: float | None
) -> None:
    """Add the poses of all knots as equations, or their tracking cost."""
    problem = symbols.problem
    for visit, (rows, knots) in enumerate(zip(mesh.visit_rows, mesh.knots)):
        approach = problem.approach_of(visit)
        if approach is None or knots is None:
            continue
        station = problem.visits[visit].station
        constants = symbols.goal_constants(station, knots.T_station_tool)
        n = len(rows)
        index = np.hstack([at.q[rows], np.tile(at.base, (n, 1)), np.tile(at.stations[station], (n, 1))])
        if tracking is not None:
            program.add_cost(symbols.tracking(approach.target, station), index, constants, tracking)
            continue
        function = symbols.target(approach.target, station)
        high = np.zeros(function.n_r)
        if approach.target is not TargetKind.POSITION:
            high[-1] = np.inf
        program.add_constraint(f"target {visit}", function, index, constants, 0.0, high)


def _add_continuity(problem: LayoutProblem, mesh: Mesh, program: StructuredProgram, at: Indices) -> None:
    """Keep neighbouring knots of an approach on one branch and within the joints' speeds."""
    for visit, (rows, knots) in enumerate(zip(mesh.visit_rows, mesh.knots)):
        if knots is None or len(knots.place) < 2:
            continue
        most = np.full((len(rows) - 1, problem.arm.n_joints), CONTINUITY)
        if knots.timed:
            # where a timed approach is slow the branch is what limits the step
            most = np.minimum(most, knots.durations_s[:, None] * problem.arm.max_velocity)
        steps = np.stack([at.q[rows[1:]].ravel(), at.q[rows[:-1]].ravel()], axis=1)
        program.add_linear(f"approach {visit}", steps, np.array([1.0, -1.0]), -most.ravel(), most.ravel())


def _add_speeds(problem: LayoutProblem, mesh: Mesh, program: StructuredProgram, at: Indices) -> None:
    """Limit joint speeds over every segment."""
    speed = problem.arm.max_velocity
    for number, rows in enumerate(mesh.transition_rows):
        before, after = at.q[rows[:-1]], at.q[rows[1:]]
        times = np.repeat(at.times[mesh.segment_time[number]][:, None], len(speed), axis=1)
        columns = np.stack([times, after, before], axis=2).reshape(-1, 3)
        share = np.repeat(mesh.segment_share[number][:, None], len(speed), axis=1)
        slowness = np.broadcast_to(1.0 / speed, share.shape)
        for sign in (1.0, -1.0):
            factors = np.stack([share, -sign * slowness, sign * slowness], axis=2).reshape(-1, 3)
            program.add_linear(f"speed {number} {sign:+.0f}", columns, factors, 0.0, np.inf)


def _add_travel(symbols: LayoutSymbols, mesh: Mesh, program: StructuredProgram, at: Indices) -> None:
    """Limit each joint's travel to what it can cover from rest to rest in the transition's time: exact, no grid."""
    arm = symbols.problem.arm
    constants = np.stack([arm.max_velocity, arm.max_acceleration], axis=1)
    for number, rows in enumerate(mesh.transition_rows):
        times = np.full(arm.n_joints, at.times[number])
        index = np.stack([at.q[rows[0]], at.q[rows[-1]], times], axis=1)
        program.add_constraint(f"travel {number}", symbols.travel(), index, constants, 0.0, np.inf)


def _add_accelerations(symbols: LayoutSymbols, mesh: Mesh, program: StructuredProgram, at: Indices) -> None:
    """Constant accelerations over every segment, within their limits; timed approaches are met at their own speed."""
    arm = symbols.problem.arm
    limit = arm.max_acceleration / arm.max_velocity
    for number, rows in enumerate(mesh.transition_rows):
        before, after = rows[:-1], rows[1:]
        shape = (len(before), arm.n_joints)
        times = np.broadcast_to(at.times[mesh.segment_time[number]][:, None], shape)
        part = np.broadcast_to(mesh.segment_share[number][:, None], shape)
        index = np.stack([at.q[before], at.q[after], at.velocity[before], at.velocity[after], times], axis=2)
        constants = np.stack([np.broadcast_to(arm.max_velocity, shape), part], axis=2)
        program.add_constraint(
            f"motion {number}", symbols.shift(), index.reshape(-1, 5), constants.reshape(-1, 2), 0.0, 0.0
        )
        columns = np.stack([times, at.velocity[after], at.velocity[before]], axis=2).reshape(-1, 3)
        for sign in (1.0, -1.0):
            factors = np.stack([part * limit, np.full(shape, -sign), np.full(shape, sign)], axis=2).reshape(-1, 3)
            program.add_linear(f"acceleration {number} {sign:+.0f}", columns, factors, 0.0, np.inf)
    for visit, (rows, knots) in enumerate(zip(mesh.visit_rows, mesh.knots)):
        if knots is None or not knots.timed:
            continue
        pace = 1.0 / (knots.durations_s[:, None] * arm.max_velocity)
        for name, row, piece in (("entry", rows[0], 0), ("exit", rows[-1], -1)):
            ends = (rows[1], rows[0]) if piece == 0 else (rows[-1], rows[-2])
            columns = np.stack([at.velocity[row], at.q[ends[0]], at.q[ends[1]]], axis=1)
            factors = np.stack([np.ones(arm.n_joints), -pace[piece], pace[piece]], axis=1)
            program.add_linear(f"{name} {visit}", columns, factors, 0.0, 0.0)
        if len(rows) > 2:
            columns = np.stack([at.q[rows[2:]], at.q[rows[1:-1]], at.q[rows[:-2]]], axis=2).reshape(-1, 3)
            factors = np.stack([pace[1:], -pace[1:] - pace[:-1], pace[:-1]], axis=2).reshape(-1, 3)
            between = 0.5 * (knots.durations_s[1:] + knots.durations_s[:-1])
            most = np.outer(between, limit).ravel()
            program.add_linear(f"approach acceleration {visit}", columns, factors, -most, most)


def run_layout_nlp(nlp: LayoutNLP, compiled: CompiledProgram, start: LayoutPoint) -> NLPResult:
    """Solve a compiled program from a point; slack starts at what the point needs."""
    x0 = np.clip(nlp.pack(start), compiled.lower, compiled.upper)
    part = nlp.program.variables["slack"]
    if part.stop > part.start:
        gaps = np.asarray(compiled.constraint(x0))[nlp.check_rows, 0]
        x0[part] = np.maximum(compiled.low[nlp.check_rows] - gaps, 0.0)
    solved = compiled.solve(x0)
    return NLPResult(nlp.unpack(solved.x), solved.objective, solved.status, solved.iterations, solved.violation)
