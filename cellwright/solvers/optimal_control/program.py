"""The discrete optimal control problem of Bjorkenstam 2014, section 2.3, built once an arm and solved for many motions.

Unknown are the positions q_0 .. q_N, the velocities v_k = (q_{k+1} - q_k) / h and torques u_k of the N steps'
middles, the velocities w_0 .. w_N of the nodes, and the duration T = N h. Equations: the discrete Legendre transform
of the velocity at every node, from the step before it and from the step behind it; both together are the discrete
Euler-Lagrange equations; all in torque units a joint limit. Cost: sum of h (c_t + c_e u_k . u_k + c_v s_k), where s_k
is the step's mean of the squared speed by Simpson's rule from w_k, v_k and w_{k+1}. With ``bound_nodes=False`` it is
the paper's program: velocities of the two ends alone, and v_k . v_k in place of s_k. Velocities of the nodes are
limited, as those of the steps are, and so may be the accelerations of the cubic Hermite curve through them. Ends,
boundary velocities and boxes of the positions enter through bounds alone, so one compiled program serves every motion
of an arm. Solved by Ipopt; local optima only. Some 20 to 100 ms a motion at N = 20.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.errors import InvalidInputError
from cellwright.solvers.optimal_control.discrete_mechanics import DiscreteMechanics
from cellwright.solvers.structured_program import CompiledProgram, LocalFunction, StructuredProgram

FEWEST_STEPS = 4
SHORTEST_DURATION, LONGEST_DURATION = 1e-3, 1e3
"""Seconds between which a duration is sought."""
WARM_BARRIER = 1e-4
"""Ipopt's first barrier parameter from a solution nearby: low enough to stay there, high enough to move on bounds."""


@dataclass(frozen=True)
class CostWeights:
    """Weights of the cost, the integral of ``time + effort u . u + velocity qdot . qdot``.

    Attributes:
        time: c_t, per s.
        effort: c_e, per (N m)^2 s, of prismatic joints per N^2 s.
        velocity: c_v, s per rad^2, of prismatic joints per m^2.

    The defaults are those of Bjorkenstam 2014, section 3.
    """

    time: float = 1.0
    effort: float = 1e-6
    velocity: float = 1.0

    def __post_init__(self) -> None:
        """Check the weights.

        Raises:
            InvalidInputError: If one is negative or not finite, or time costs nothing.
        """
        for name in ("time", "effort", "velocity"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InvalidInputError(f"the weight {name} is {value:g}: give a finite one of at least 0")
        if self.time <= 0.0:
            raise InvalidInputError("the weight time is 0: a motion could take forever; give one above 0")

    def rate(self, v: FloatArray, torque: FloatArray) -> FloatArray:
        """Return the cost per s (...) of velocities and torques (..., joints)."""
        return np.asarray(self.time + self.effort * np.sum(torque**2, -1) + self.velocity * np.sum(v**2, -1))


@dataclass(frozen=True, eq=False)
class DiscreteMotion:
    """A solution, or the point where the solver stopped.

    Attributes:
        step: h in s.
        q: Positions at the nodes, (steps + 1, joints).
        velocity: In the steps' middles, (steps, joints).
        torque: In the steps' middles, (steps, joints) in N m or N.
        node_velocity: At the nodes by the discrete Legendre transform, (steps + 1, joints).
        cost: The discrete cost.
        converged: Whether the solver reports an optimum and all equations hold.
        status: The solver's own word.
        iterations: Of the solver.
        violation: Largest residual of an equation, as a share of the torque limits.
        multipliers: Of the equations and of the bounds, for the next start.
    """

    step: float
    q: FloatArray
    velocity: FloatArray
    torque: FloatArray
    node_velocity: FloatArray
    cost: float
    converged: bool
    status: str
    iterations: int
    violation: float
    multipliers: tuple[FloatArray, FloatArray] | None = None

    @property
    def duration(self) -> float:
        """T in s."""
        return self.step * len(self.torque)

    @property
    def time(self) -> FloatArray:
        """Of the nodes, (steps + 1,) in s."""
        return np.asarray(self.step * np.arange(len(self.q)), np.float64)


class MotionProgram:
    """The optimal control problem of one arm, ready to be solved from many starts to many goals.

    Attributes:
        mechanics: The arm's discrete mechanics.
        weights: Of the cost.
        n_steps: N.
        max_effort: Torque limits, (joints,) in N m or N.
        max_acceleration: Acceleration limits of the curve through the nodes, (joints,); None where there are none.
        reserve: Shares of speed and acceleration limits, and of torque limits, that the program leaves unused.
    """

    def __init__(
        self,
        dynamics: SymbolicDynamics,
        weights: CostWeights | None = None,
        *,
        n_steps: int = 20,
        max_effort: FloatArray | None = None,
        bound_nodes: bool = True,
        most_iterations: int = 300,
        max_acceleration: FloatArray | None = None,
        reserve: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Build the program.

        ``max_effort`` (joints,) replaces the URDF's limits. ``max_acceleration`` (joints,) in rad/s^2 or m/s^2 limits
        the cubic Hermite curve through nodes and node velocities, so it needs ``bound_nodes``. What lies between the
        nodes may use the ``reserve``.

        Raises:
            InvalidInputError: If a torque limit is missing or not positive, or there are too few steps.
        """
        if max_acceleration is not None and not bound_nodes:
            raise InvalidInputError("max_acceleration limits a curve through node velocities: leave bound_nodes true")
        if n_steps < FEWEST_STEPS:
            raise InvalidInputError(f"n_steps is {n_steps}: give at least {FEWEST_STEPS}")
        self.mechanics = DiscreteMechanics(dynamics)
        self.weights = weights or CostWeights()
        self.n_steps, self._most_iterations = n_steps, most_iterations
        self.max_effort = effort_limits(dynamics, max_effort)
        self.bound_nodes = bound_nodes
        self.max_acceleration, self.reserve = max_acceleration, reserve
        self._layout = _Layout(dynamics.n_joints, n_steps, bound_nodes)
        program = self._filled(dynamics)
        self._cold = program.compiled(most_iterations=most_iterations)
        self._steady = program.compiled(most_iterations=most_iterations, **_STEADY)
        self._warm = program.compiled(most_iterations=most_iterations, **_WARM)

    @property
    def dynamics(self) -> SymbolicDynamics:
        """The arm."""
        return self.mechanics.dynamics

    def with_steps(self, n_steps: int) -> MotionProgram:
        """Return the same program with another number of steps.

        Raises:
            InvalidInputError: If there are too few.
        """
        return MotionProgram(
            self.dynamics,
            self.weights,
            n_steps=n_steps,
            max_effort=self.max_effort,
            bound_nodes=self.bound_nodes,
            most_iterations=self._most_iterations,
            max_acceleration=self.max_acceleration,
            reserve=self.reserve,
        )

    def _filled(self, dynamics: SymbolicDynamics) -> StructuredProgram:
        n, steps, at = dynamics.n_joints, self.n_steps, self._layout
        speed, nodes = (1.0 - self.reserve[0]) * dynamics.max_velocity, len(at.w)
        most_torque = (1.0 - self.reserve[1]) * np.ones(steps * n)
        program = StructuredProgram()
        program.add_variables("q", np.tile(dynamics.lower, steps + 1), np.tile(dynamics.upper, steps + 1))
        program.add_variables("v", np.tile(-speed, steps), np.tile(speed, steps))
        program.add_variables("u", -most_torque, most_torque)
        program.add_variables("w", np.tile(-speed, nodes), np.tile(speed, nodes))
        program.add_variables("T", np.array([SHORTEST_DURATION]), np.array([LONGEST_DURATION]))
        q0, q1, v, u, w = (casadi.SX.sym(name, n) for name in ("q0", "q1", "v", "u", "w"))
        T, none = casadi.SX.sym("T"), casadi.SX(0, 1)
        h, scale = T / steps, casadi.DM(self.max_effort)
        begin, end = self.mechanics.ends(0.5 * (q0 + q1), v, h)
        push = 0.5 * h * scale * u
        begins, ends = self._momentum_rows(program)
        nothing = np.zeros((steps, 0))
        duration = np.full((steps, 1), at.T)
        step = LocalFunction(
            "step", casadi.vertcat(q0, q1, v, u, T), none, casadi.vertcat((push - begin) / scale, (end + push) / scale)
        )
        index = np.hstack([at.q[:-1], at.q[1:], at.v, at.u, duration])
        program.add_to_rows(np.hstack([begins, ends]), step, index, nothing)
        p = self.mechanics.momentum_expression(q0, w) / scale
        node = LocalFunction("node", casadi.vertcat(q0, w), none, p)
        against = LocalFunction("against", casadi.vertcat(q0, w), none, -p)
        first, last = np.hstack([at.q, at.node_w]), np.hstack([at.q, at.node_w])
        has = at.node_w[:, 0] >= 0
        program.add_to_rows(begins[has[:-1]], node, first[:-1][has[:-1]], np.zeros((int(has[:-1].sum()), 0)))
        program.add_to_rows(ends[has[1:]], against, last[1:][has[1:]], np.zeros((int(has[1:].sum()), 0)))
        way = LocalFunction("way", casadi.vertcat(q0, q1, v, T), none, q1 - q0 - h * v)
        program.add_constraint("way", way, np.hstack([at.q[:-1], at.q[1:], at.v, duration]), nothing, 0.0, 0.0)
        if self.max_acceleration is not None:
            self._limit_curve(program, speed, (1.0 - self.reserve[0]) * self.max_acceleration)
        self._add_cost(program)
        return program

    def _momentum_rows(self, program: StructuredProgram) -> tuple[IntArray, IntArray]:
        """Return the rows (steps, joints) of the momentum with which each step begins, and of that with which it ends.

        Where the velocity at a node is no unknown both are one row: the discrete Euler-Lagrange equation.
        """
        n, steps = self.dynamics.n_joints, self.n_steps
        if self.bound_nodes:
            rows = program.add_rows("momentum", *np.zeros((2, 2 * steps * n))).reshape(2, steps, n)
            return rows[0], rows[1]
        shared = program.add_rows("momentum", *np.zeros((2, (steps + 1) * n))).reshape(steps + 1, n)
        return shared[:-1], shared[1:]

    def _limit_curve(self, program: StructuredProgram, speed: FloatArray, acceleration: FloatArray) -> None:
        """Limit the Hermite curve: its acceleration at both ends of each step, its speed within.

        The acceleration of a cubic is a line, so that its ends bound it; its speed is a parabola, which lies between
        its three Bernstein coefficients, of which the outer two are the node velocities. All are linear.
        """
        at, steps = self._layout, self.n_steps
        v, w0, w1 = at.v.ravel(), at.w[:-1].ravel(), at.w[1:].ravel()
        duration = np.full(len(v), at.T)
        columns = np.stack([v, w0, w1, duration], axis=1)
        most = np.tile(acceleration, steps) / steps
        for name, factors in (("begin", (6.0, -4.0, -2.0)), ("end", (-6.0, 2.0, 4.0))):
            for sign in (1.0, -1.0):
                each = np.column_stack([np.tile(sign * np.array(factors), (len(v), 1)), -most])
                program.add_linear(f"acceleration at {name}, {sign:g}", columns, each, -np.inf, 0.0)
        middle = np.tile(speed, steps)
        program.add_linear("speed", columns[:, :3], np.array([3.0, -1.0, -1.0]), -middle, middle)

    def _add_cost(self, program: StructuredProgram) -> None:
        n, steps, at, weights = self.dynamics.n_joints, self.n_steps, self._layout, self.weights
        v, u, w0, w1 = (casadi.SX.sym(name, n) for name in ("v", "u", "w0", "w1"))
        T, none, scale = casadi.SX.sym("T"), casadi.SX(0, 1), casadi.DM(self.max_effort)
        square = casadi.sumsqr(v)
        z, index = [v, u, T], [at.v, at.u, np.full((steps, 1), at.T)]
        if self.bound_nodes:
            square = (casadi.sumsqr(w0) + 4.0 * square + casadi.sumsqr(w1)) / 6.0
            z, index = [*z, w0, w1], [*index, at.w[:-1], at.w[1:]]
        rate = weights.time + weights.effort * casadi.sumsqr(scale * u) + weights.velocity * square
        if self.max_acceleration is not None:
            rate += SMOOTHING * weights.time * self._mean_acceleration_square(v, w0, w1, T / steps)
        cost = LocalFunction("cost", casadi.vertcat(*z), none, T / steps * rate)
        program.add_cost(cost, np.hstack(index), np.zeros((steps, 0)), 1.0)

    def _mean_acceleration_square(self, v: Any, w0: Any, w1: Any, h: Any) -> Any:
        """Return the mean over a step of the curve's squared accelerations, each as a share of its limit."""
        most = casadi.DM(self.max_acceleration)
        begin, end = (6.0 * v - 4.0 * w0 - 2.0 * w1) / h / most, (-6.0 * v + 2.0 * w0 + 4.0 * w1) / h / most
        return (casadi.sumsqr(begin) + casadi.dot(begin, end) + casadi.sumsqr(end)) / 3.0

    def solve(
        self,
        start: DiscreteMotion,
        *,
        v_a: FloatArray | None = None,
        v_b: FloatArray | None = None,
        boxes: tuple[FloatArray, FloatArray] | None = None,
        warm: bool = False,
    ) -> DiscreteMotion:
        """Return the best motion near ``start`` between its two ends.

        Args:
            start: Where the solver begins; its first and last position are the ends of the motion.
            v_a, v_b: Velocities at the ends, (joints,); at rest if left out.
            boxes: Lower and upper positions of the nodes, (steps + 1, joints) each, within the joint limits.
            warm: Whether ``start`` is the solution of a motion nearby: its multipliers are used too.
        """
        at, cold = self._layout, self._cold
        lower, upper = cold.lower.copy(), cold.upper.copy()
        if boxes is not None:
            lower[at.q], upper[at.q] = np.maximum(lower[at.q], boxes[0]), np.minimum(upper[at.q], boxes[1])
        for node, v in ((0, v_a), (-1, v_b)):
            lower[at.q[node]] = upper[at.q[node]] = start.q[node]
            lower[at.w[node]] = upper[at.w[node]] = 0.0 if v is None else v
        bounds = {"lbx": lower, "ubx": upper, "lbg": cold.low, "ubg": cold.high}
        x0 = np.clip(self._packed(start), lower, upper)
        if warm and start.multipliers is not None:
            lam_g, lam_x = start.multipliers
            found = self._read(self._warm, self._warm.solver(x0=x0, lam_g0=lam_g, lam_x0=lam_x, **bounds), lower, upper)
            if found.converged:
                return found
        found = self._read(self._cold, self._cold.solver(x0=x0, **bounds), lower, upper)
        return (
            found if found.converged else self._read(self._steady, self._steady.solver(x0=x0, **bounds), lower, upper)
        )

    def _node_velocity(self, x: FloatArray) -> FloatArray:
        at = self._layout
        if self.bound_nodes:
            return np.array(x[at.w])
        found = self.mechanics.node_velocities(x[at.q], x[at.u] * self.max_effort, float(x[at.T]) / self.n_steps)
        found[[0, -1]] = x[at.w]
        return found

    def _packed(self, motion: DiscreteMotion) -> FloatArray:
        x, at = np.empty(self._layout.T + 1), self._layout
        x[at.q], x[at.v], x[at.u] = motion.q, motion.velocity, motion.torque / self.max_effort
        x[at.w] = motion.node_velocity[at.nodes]
        x[at.T] = motion.duration
        return x

    def _read(self, program: CompiledProgram, found: Any, lower: FloatArray, upper: FloatArray) -> DiscreteMotion:
        at, statistics = self._layout, program.solver.stats()
        # the solver relaxes bounds by 1e-8 of their size
        x = np.clip(np.asarray(found["x"])[:, 0], lower, upper)
        g = np.asarray(program.constraint(x))[:, 0]
        violation = float(np.maximum(program.low - g, g - program.high).max())
        usable = bool(np.isfinite(x).all()) and math.isfinite(violation)
        return DiscreteMotion(
            float(x[at.T]) / self.n_steps,
            x[at.q],
            x[at.v],
            x[at.u] * self.max_effort,
            self._node_velocity(x),
            float(program.cost(x)),
            bool(statistics["success"]) and usable and violation <= LARGEST_VIOLATION,
            str(statistics["return_status"]),
            int(statistics["iter_count"]),
            violation if usable else math.inf,
            (np.asarray(found["lam_g"])[:, 0], np.asarray(found["lam_x"])[:, 0]),
        )


LARGEST_VIOLATION = 1e-6
"""Residual of an equation, as a share of a torque limit times s (or rad, m), above which a point is no motion."""

SMOOTHING = 0.03
"""What each joint at its acceleration limit adds to the solver's cost, as a share of that of time, where there are such
limits: joints that do not decide the duration would else tremble within them, as hardly anything depends on it."""

_STEADY: dict[str, Any] = {"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 0.1}
"""A second try: slower, and seldom led astray by the adaptive barrier."""

_WARM: dict[str, Any] = {
    "ipopt.warm_start_init_point": "yes",
    "ipopt.mu_strategy": "monotone",
    "ipopt.mu_init": WARM_BARRIER,
    "ipopt.warm_start_bound_push": 1e-5,
    "ipopt.warm_start_mult_bound_push": 1e-5,
    "ipopt.warm_start_slack_bound_push": 1e-5,
}


class _Layout:
    """Where the variables lie; ``w`` are velocities at nodes, ``node_w`` theirs or -1 of every node."""

    def __init__(self, n: int, steps: int, bound_nodes: bool) -> None:
        self.q: IntArray = np.arange((steps + 1) * n).reshape(steps + 1, n)
        self.v: IntArray = self.q.size + np.arange(steps * n).reshape(steps, n)
        self.u: IntArray = self.v + steps * n
        nodes = np.arange(steps + 1) if bound_nodes else np.array([0, steps])
        self.nodes = nodes
        self.w: IntArray = self.q.size + 2 * steps * n + np.arange(len(nodes) * n).reshape(-1, n)
        self.T = self.q.size + 2 * steps * n + self.w.size
        self.node_w: IntArray = np.full((steps + 1, n), -1)
        self.node_w[nodes] = self.w


def effort_limits(dynamics: SymbolicDynamics, max_effort: FloatArray | None) -> FloatArray:
    """Return the torque limits (joints,) of an arm: those given, else the URDF's.

    Raises:
        InvalidInputError: If one is missing, not positive or not finite.
    """
    limits = np.array(dynamics.max_effort if max_effort is None else max_effort, float)
    if limits.shape != (dynamics.n_joints,):
        raise InvalidInputError(f"max_effort has shape {limits.shape}, but the arm has {dynamics.n_joints} joints")
    for name, limit in zip(dynamics.joint_names, limits):
        if not (math.isfinite(limit) and limit > 0.0):
            raise InvalidInputError(
                f"joint {name!r} has torque limit {limit:g}: optimal control needs a positive, finite one; "
                'add effort="..." to its <limit> or give max_effort'
            )
    return limits
