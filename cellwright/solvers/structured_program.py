"""Nonlinear programs made of many instances of few small functions, with derivatives assembled, not rediscovered.

A layout program repeats the same small functions (a sphere's gap at one configuration, a tool's error) thousands of
times on different variables. Each function is differentiated once, symbolically, over its own dozen variables, mapped
over its instances, and the sparse Jacobian and Hessian of the Lagrangian are put together from the pieces by constant
index lists. Building a program with thousands of constraints so takes milliseconds, where differentiating the whole
expression takes seconds, and its Hessian costs no graph colouring. Solved by Ipopt through CasADi.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from cellwright.arrays import FloatArray, IntArray

_OPTIONS = {
    "print_time": False,
    "calc_lam_p": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-7,
    "ipopt.constr_viol_tol": 1e-8,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_constr_viol_tol": 1e-8,
    "ipopt.acceptable_iter": 8,
    "ipopt.mu_strategy": "adaptive",
    "ipopt.fast_step_computation": "yes",
    # approximate minimum degree: on these matrices a fifth faster in all than the order that MUMPS chooses
    "ipopt.mumps_pivot_order": 0,
    # the limit is on iterations, so that equal inputs give equal results on any machine
    "ipopt.max_wall_time": 1e9,
    "ipopt.max_cpu_time": 1e9,
}

_WARM = {
    "ipopt.mu_strategy": "monotone",
    "ipopt.mu_init": 1e-4,
    "ipopt.bound_push": 1e-4,
    "ipopt.bound_frac": 1e-4,
    "ipopt.slack_bound_push": 1e-4,
    "ipopt.slack_bound_frac": 1e-4,
}
"""For starts near the solution: stay where one is, at its active bounds too."""


class LocalFunction:
    """A small function r(z, p) with its derivatives by z: the Jacobian and the Hessian of ``lambda @ r``.

    ``z`` are variables of the program, ``p`` constants of an instance; all are CasADi SX columns.
    """

    def __init__(self, name: str, z: Any, p: Any, r: Any) -> None:
        multiplier = casadi.SX.sym("multiplier", r.size1())
        H = casadi.hessian(casadi.dot(multiplier, r), z)[0]
        self._keep(name, z, p, r, casadi.jacobian(r, z), multiplier, H)

    def _keep(self, name: str, z: Any, p: Any, r: Any, J: Any, multiplier: Any, H: Any) -> None:
        self.n_z, self.n_p, self.n_r = z.size1(), p.size1(), r.size1()
        H = casadi.triu(H)
        self.value = casadi.Function(name, [z, p], [r])
        self.jacobian = casadi.Function(name, [z, p], [J.nz[:]])
        self.hessian = casadi.Function(name, [z, p, multiplier], [H.nz[:]])
        self.jacobian_rows, self.jacobian_columns = (np.array(part, np.int64) for part in J.sparsity().get_triplet())
        self.hessian_rows, self.hessian_columns = (np.array(part, np.int64) for part in H.sparsity().get_triplet())

    @classmethod
    def scaled(cls, name: str, z: Any, p: Any, scale: Any, x: Any, f: Any, x_at: Any) -> LocalFunction:
        """Return ``scale(z, p) * f(x_at(z, p))`` of one output, ``f`` an expression of the column ``x`` alone.

        The second derivatives of ``f`` are taken by ``x`` and carried over by the chain rule: far fewer operations
        where ``f`` is long and ``z`` has more entries than ``x``.
        """
        n = x.size1()
        inner = casadi.Function("inner", [x], [f, *reversed(casadi.hessian(f, x))])
        at, value, slope = casadi.SX.sym("at", n), casadi.SX.sym("value"), casadi.SX.sym("slope", n)
        curvature = casadi.SX.sym("curvature", n, n)
        away = x_at - at
        # equal to f in value, slope and curvature where x is ``at``
        parabola = scale * (value + casadi.dot(slope, away) + 0.5 * casadi.dot(away, curvature @ away))
        multiplier = casadi.SX.sym("multiplier")
        H, J = casadi.hessian(parabola, z)
        f_at, slope_at, curvature_at = inner(x_at)
        names, values = [at, value, slope, curvature], [x_at, f_at, slope_at, casadi.densify(curvature_at)]
        J, H = casadi.substitute([J.T, multiplier * H], names, values)
        made = cls.__new__(cls)
        made._keep(name, z, p, scale * f_at, J, multiplier, H)
        return made


@dataclass(frozen=True, eq=False)
class _Term:
    """Instances of one function: their variables (n, n_z), constants (n, n_p), and rows of g or the cost's weight."""

    function: LocalFunction
    index: IntArray
    constants: FloatArray
    rows: IntArray | None
    weight: float = 0.0


@dataclass(frozen=True, eq=False)
class Solved:
    """What Ipopt returned: x, objective, status, iterations, the largest violation of a constraint, and success."""

    x: FloatArray
    objective: float
    status: str
    iterations: int
    violation: float
    success: bool


class StructuredProgram:
    """Minimise a cost with ``lower <= x <= upper`` and ``low <= g(x) <= high``; fill it, then `solve`."""

    def __init__(self) -> None:
        self.n_variables = 0
        self.n_constraints = 0
        self.variables: dict[str, slice] = {}
        self.constraints: dict[str, slice] = {}
        self._bounds: list[tuple[FloatArray, FloatArray]] = []
        self._rows: list[tuple[FloatArray, FloatArray]] = []
        self._terms: list[_Term] = []
        self._linear: list[tuple[IntArray, IntArray, FloatArray]] = []
        self._cost: list[tuple[IntArray, FloatArray]] = []

    def add_variables(self, name: str, lower: FloatArray, upper: FloatArray) -> IntArray:
        """Add bounded variables; return their indices."""
        index = np.arange(self.n_variables, self.n_variables + len(lower))
        self.variables[name] = slice(self.n_variables, self.n_variables + len(lower))
        self.n_variables += len(lower)
        self._bounds.append((np.asarray(lower, float), np.asarray(upper, float)))
        return index

    def _add_rows(self, name: str, low: FloatArray, high: FloatArray) -> IntArray:
        rows = np.arange(self.n_constraints, self.n_constraints + len(low))
        self.constraints[name] = slice(self.n_constraints, self.n_constraints + len(low))
        self.n_constraints += len(low)
        self._rows.append((low, high))
        return rows

    def add_constraint(
        self,
        name: str,
        function: LocalFunction,
        index: IntArray,
        constants: FloatArray,
        low: float | FloatArray,
        high: float | FloatArray,
    ) -> IntArray:
        """Bound every output of every instance; return the rows (n, n_r). ``low``, ``high`` broadcast to that."""
        shape = (len(index), function.n_r)
        bounds = [np.broadcast_to(np.asarray(bound, float), shape).ravel() for bound in (low, high)]
        rows = self._add_rows(name, *bounds).reshape(shape)
        if len(index):
            self._terms.append(_Term(function, np.asarray(index), np.asarray(constants, float), rows))
        return rows

    def add_rows(self, name: str, low: FloatArray, high: FloatArray) -> IntArray:
        """Add constraints that are sums of instances, to be filled by `add_to_rows`; return the rows (n,)."""
        return self._add_rows(name, np.asarray(low, float), np.asarray(high, float))

    def add_to_rows(self, rows: IntArray, function: LocalFunction, index: IntArray, constants: FloatArray) -> None:
        """Add every output of every instance to the row at its place in ``rows`` (n, n_r); rows may repeat."""
        self._terms.append(_Term(function, np.asarray(index), np.asarray(constants, float), np.asarray(rows)))

    def add_linear(
        self,
        name: str,
        columns: IntArray,
        factors: FloatArray,
        low: float | FloatArray,
        high: float | FloatArray,
    ) -> IntArray:
        """Bound sums ``factors @ x[columns]``, one a row of ``columns`` (n, k); return the rows (n,)."""
        n = len(columns)
        bounds = [np.array(np.broadcast_to(np.asarray(bound, float), n)) for bound in (low, high)]
        rows = self._add_rows(name, *bounds)
        factors = np.broadcast_to(np.asarray(factors, float), columns.shape)
        self._linear.append((np.repeat(rows, columns.shape[1]), columns.ravel(), factors.ravel()))
        return rows

    def relax(self, rows: IntArray, slack: IntArray, factor: float = 1.0) -> None:
        """Add ``factor`` times one variable to each row."""
        self._linear.append((rows, slack, np.full(len(rows), factor)))

    def add_cost(self, function: LocalFunction, index: IntArray, constants: FloatArray, weight: float) -> None:
        """Add the sum of a function's instances (one output), times a weight, to the cost."""
        self._terms.append(_Term(function, np.asarray(index), np.asarray(constants, float), None, weight))

    def add_linear_cost(self, columns: IntArray, factor: float | FloatArray) -> None:
        """Add ``factor @ x[columns]`` to the cost."""
        self._cost.append((columns, np.array(np.broadcast_to(np.asarray(factor, float), len(columns)))))

    @property
    def lower(self) -> FloatArray:
        """Lower bounds of x."""
        return np.concatenate([low for low, _ in self._bounds])

    @property
    def upper(self) -> FloatArray:
        """Upper bounds of x."""
        return np.concatenate([high for _, high in self._bounds])

    @property
    def low(self) -> FloatArray:
        """Lower bounds of g."""
        return np.concatenate([np.zeros(0), *(low for low, _ in self._rows)])

    @property
    def high(self) -> FloatArray:
        """Upper bounds of g."""
        return np.concatenate([np.zeros(0), *(high for _, high in self._rows)])

    def compiled(self, *, most_iterations: int = 300, warm: bool = False, **options: Any) -> CompiledProgram:
        """Return the program with its derivatives, ready to be solved from several points."""
        return CompiledProgram(self, most_iterations, warm, options)


_NEVER_BEGUN = ("Not_Enough_Degrees_Of_Freedom", "Invalid_Problem_Definition", "Invalid_Option", "Internal_Error")


def _iterations(statistics: dict[str, Any]) -> int:
    """Return how many iterations Ipopt made; of a program that it never began CasADi hands on what was in memory."""
    return 0 if statistics["return_status"] in _NEVER_BEGUN else int(statistics["iter_count"])


class CompiledProgram:
    """A `StructuredProgram` as CasADi functions: ``f``, ``g``, gradient, Jacobian, Hessian, and the solver."""

    def __init__(self, program: StructuredProgram, most_iterations: int, warm: bool, options: dict[str, Any]) -> None:
        self.lower, self.upper, self.low, self.high = program.lower, program.upper, program.low, program.high
        n, m = program.n_variables, program.n_constraints
        x, p = casadi.MX.sym("x", n), casadi.MX.sym("p", 0)
        lam_f, lam_g = casadi.MX.sym("lam_f"), casadi.MX.sym("lam_g", m)
        linear = _Linear(program, n, m)
        f, g, gradient = linear.cost @ x, linear.matrix @ x, linear.cost.T
        jacobian, hessian = linear.entries(), _Entries()
        for term in _merged(program._terms):
            count = len(term.index)
            z = casadi.reshape(x[term.index.ravel().tolist()], term.function.n_z, count)
            constants = casadi.DM(np.ascontiguousarray(term.constants.T))
            value = casadi.vec(term.function.value.map(count)(z, constants))
            slopes = casadi.vec(term.function.jacobian.map(count)(z, constants))
            columns = term.index[:, term.function.jacobian_columns].ravel()
            if term.rows is None:
                f += term.weight * casadi.sum1(value)
                gradient += term.weight * _scatter(columns, np.zeros(len(columns), np.int64), n, 1) @ slopes
                multipliers = casadi.repmat(term.weight * lam_f, term.function.n_r, count)
            else:
                g += _scatter(term.rows.ravel(), np.zeros(term.rows.size, np.int64), m, 1) @ value
                jacobian.add(term.rows[:, term.function.jacobian_rows].ravel(), columns, slopes)
                multipliers = casadi.reshape(lam_g[term.rows.ravel().tolist()], term.function.n_r, count)
            curvature = casadi.vec(term.function.hessian.map(count)(z, constants, multipliers))
            one = term.index[:, term.function.hessian_rows].ravel()
            other = term.index[:, term.function.hessian_columns].ravel()
            # a pair of one variable with itself off the local diagonal counts for both triangles
            doubled = (one == other) & np.repeat(
                [term.function.hessian_rows != term.function.hessian_columns], count, axis=0
            ).ravel()
            hessian.add(np.minimum(one, other), np.maximum(one, other), curvature, np.where(doubled, 2.0, 1.0))
        J, H = jacobian.matrix(m, n), hessian.matrix(n, n)
        self.cost = casadi.Function("f", [x], [f])
        self.constraint = casadi.Function("g", [x], [g])
        functions = {
            "grad_f": casadi.Function("nlp_grad_f", [x, p], [f, gradient], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": casadi.Function("nlp_jac_g", [x, p], [g, J], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": casadi.Function(
                "nlp_hess_l", [x, p, lam_f, lam_g], [H], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
            ),
        }
        self.functions = functions
        chosen = {**_OPTIONS, "ipopt.max_iter": most_iterations}
        if warm:
            chosen.update(_WARM)
        self.solver = casadi.nlpsol("program", "ipopt", {"x": x, "f": f, "g": g}, {**chosen, **functions, **options})

    def solve(self, x0: FloatArray) -> Solved:
        """Run Ipopt from a point, which is first brought within its bounds."""
        found = self.solver(
            x0=np.clip(x0, self.lower, self.upper), lbx=self.lower, ubx=self.upper, lbg=self.low, ubg=self.high
        )
        statistics = self.solver.stats()
        x = np.clip(np.asarray(found["x"])[:, 0], self.lower, self.upper)
        g = np.asarray(self.constraint(x))[:, 0]
        violation = float(max(np.max(self.low - g, initial=0.0), np.max(g - self.high, initial=0.0)))
        return Solved(
            x,
            float(self.cost(x)),
            str(statistics["return_status"]),
            _iterations(statistics),
            violation if np.isfinite(x).all() else np.inf,
            bool(statistics["success"]),
        )


def _merged(terms: list[_Term]) -> list[_Term]:
    """Return one term a function (and weight): each takes several calls of CasADi, however many instances it has."""
    groups: dict[tuple[int, bool, float], list[_Term]] = {}
    for term in terms:
        groups.setdefault((id(term.function), term.rows is None, term.weight), []).append(term)
    return [
        _Term(
            group[0].function,
            np.concatenate([term.index for term in group]),
            np.concatenate([term.constants for term in group]),
            None if group[0].rows is None else np.concatenate([term.rows for term in group if term.rows is not None]),
            group[0].weight,
        )
        for group in groups.values()
    ]


def _scatter(rows: IntArray, columns: IntArray, n_rows: int, n_columns: int, factors: FloatArray | None = None) -> Any:
    """Return the constant matrix that adds entry k of a vector to place (row, column) of a matrix, flattened."""
    n = len(rows)
    place = rows + n_rows * columns
    values = np.ones(n) if factors is None else factors
    return casadi.DM.triplet(place.tolist(), list(range(n)), casadi.DM(values), n_rows * n_columns, n)


class _Entries:
    """Collects entries of a sparse matrix that are pieces of vectors."""

    def __init__(self) -> None:
        self.rows: list[IntArray] = []
        self.columns: list[IntArray] = []
        self.factors: list[FloatArray] = []
        self.values: list[Any] = []

    def add(self, rows: IntArray, columns: IntArray, values: Any, factors: FloatArray | None = None) -> None:
        """Add ``factors * values`` at places; places may repeat."""
        self.rows.append(rows)
        self.columns.append(columns)
        self.factors.append(np.ones(len(rows)) if factors is None else factors)
        self.values.append(values)

    def matrix(self, n_rows: int, n_columns: int) -> Any:
        """Return the sparse matrix as an expression."""
        if not self.rows:
            return casadi.MX(n_rows, n_columns)
        rows, columns = np.concatenate(self.rows), np.concatenate(self.columns)
        places, which = np.unique(rows + n_rows * columns, return_inverse=True)
        sparsity = casadi.Sparsity.triplet(n_rows, n_columns, (places % n_rows).tolist(), (places // n_rows).tolist())
        factors = casadi.DM(np.concatenate(self.factors))
        gather = casadi.DM.triplet(which.tolist(), list(range(len(which))), factors, len(places), len(which))
        return casadi.MX(sparsity, gather @ casadi.vertcat(*self.values))


class _Linear:
    """The linear part of a program: the cost's row and the constraints' matrix."""

    def __init__(self, program: StructuredProgram, n: int, m: int) -> None:
        cost = np.zeros(n)
        for columns, factors in program._cost:
            np.add.at(cost, columns, factors)
        self.cost = casadi.DM(cost).T
        parts = program._linear or [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
        rows = np.concatenate([rows for rows, _, _ in parts])
        columns = np.concatenate([columns for _, columns, _ in parts])
        # CasADi keeps one of two entries at one place, so they are added up first
        places, which = np.unique(rows + max(m, 1) * columns, return_inverse=True)
        self.rows, self.columns = places % max(m, 1), places // max(m, 1)
        self.factors = np.bincount(which, np.concatenate([factors for _, _, factors in parts]), len(places))
        self.matrix = casadi.DM.triplet(self.rows.tolist(), self.columns.tolist(), casadi.DM(self.factors), m, n)

    def entries(self) -> _Entries:
        """Return the Jacobian's constant entries."""
        entries = _Entries()
        if len(self.rows):
            entries.add(self.rows, self.columns, casadi.MX(casadi.DM(self.factors)))
        return entries
