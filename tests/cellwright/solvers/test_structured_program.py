from __future__ import annotations

import casadi
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.solvers.structured_program import LocalFunction, StructuredProgram


def example(seed: int) -> StructuredProgram:
    """Return a program whose instances share variables at random, also with themselves."""
    rng = np.random.default_rng(seed)
    z, p = casadi.SX.sym("z", 3), casadi.SX.sym("p", 1)
    bound = LocalFunction("bound", z, p, casadi.vertcat(z[0] * z[1] + p, casadi.sin(z[2]) * z[0]))
    cost = LocalFunction("cost", z, p, casadi.sumsqr(z - p) * z[0] ** 2)
    program = StructuredProgram()
    x = program.add_variables("x", np.full(5, -4.0), np.full(5, 4.0))
    rows = program.add_constraint("a", bound, rng.integers(0, 5, (4, 3)), rng.normal(size=(4, 1)), -2.0, 2.0)
    program.add_linear("l", rng.integers(0, 5, (3, 2)), np.array([1.0, -2.0]), -3.0, 3.0)
    slack = program.add_variables("s", np.zeros(2), np.full(2, 9.0))
    program.relax(rows[:2, 0], slack, -1.0)
    program.add_cost(cost, rng.integers(0, 5, (3, 3)), rng.normal(size=(3, 1)), 0.5)
    program.add_linear_cost(x, 0.3)
    program.add_linear_cost(slack, 5.0)
    return program


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_assembled_derivatives_equal_those_of_the_whole_expression(seed: int) -> None:
    compiled = example(seed).compiled()
    rng = np.random.default_rng(seed)
    n, m = len(compiled.lower), len(compiled.low)
    at, lam = rng.normal(size=n), rng.normal(size=m)
    x = casadi.MX.sym("x", n)
    f, g = compiled.cost(x), compiled.constraint(x)
    whole = casadi.Function(
        "whole",
        [x],
        [
            casadi.gradient(f, x),
            casadi.jacobian(g, x),
            casadi.triu(casadi.hessian(2.0 * f + casadi.dot(casadi.DM(lam), g), x)[0]),
        ],
    )
    gradient, jacobian, hessian = (np.asarray(part) for part in whole(at))
    np.testing.assert_allclose(compiled.functions["grad_f"](at, [])[1], gradient, atol=1e-10)
    np.testing.assert_allclose(compiled.functions["jac_g"](at, [])[1], jacobian, atol=1e-10)
    np.testing.assert_allclose(compiled.functions["hess_lag"](at, [], 2.0, lam), hessian, atol=1e-10)


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_derivatives_by_the_chain_rule_equal_those_of_the_whole_expression(seed: int) -> None:
    z, p, x = casadi.SX.sym("z", 4), casadi.SX.sym("p", 2), casadi.SX.sym("x", 2)
    inner = casadi.sin(x[0]) * x[1] ** 2 + x[0]
    at = casadi.vertcat(p[0] * z[0] + (1.0 - p[0]) * z[1] * z[2], z[1] - p[1])
    scale = p[1] * z[3] / (1.0 + z[0] ** 2)
    chained = LocalFunction.scaled("chained", z, p, scale, x, inner, at)
    plain = LocalFunction("plain", z, p, scale * casadi.substitute(inner, x, at))
    rng = np.random.default_rng(seed)
    where = rng.normal(size=4), rng.normal(size=2)
    np.testing.assert_allclose(chained.value(*where), plain.value(*where), atol=1e-10)
    for name, n in (("jacobian", 1), ("hessian", 4)):
        dense = []
        for function in (chained, plain):
            rows, columns = getattr(function, f"{name}_rows"), getattr(function, f"{name}_columns")
            full = np.zeros((n, 4))
            full[rows, columns] = np.asarray(getattr(function, name)(*where, *([2.0] if n == 4 else []))).ravel()
            dense.append(full)
        np.testing.assert_allclose(*dense, atol=1e-10)


def test_a_known_program_is_solved() -> None:
    z = casadi.SX.sym("z", 2)
    circle = LocalFunction("circle", z, casadi.SX(0, 1), casadi.sumsqr(z))
    program = StructuredProgram()
    x = program.add_variables("x", np.full(2, -2.0), np.full(2, 2.0))
    program.add_constraint("on the disc", circle, x[None], np.zeros((1, 0)), -np.inf, 1.0)
    program.add_linear_cost(x, np.array([3.0, 4.0]))
    solved = program.compiled().solve(np.array([0.5, 0.1]))
    assert solved.success
    np.testing.assert_allclose(solved.x, [-0.6, -0.8], atol=1e-6)
    assert solved.violation < 1e-7


def test_a_program_that_never_begins_makes_no_iterations() -> None:
    program = StructuredProgram()
    x = program.add_variables("x", np.zeros(1), np.ones(1))
    program.add_linear("two demands", np.stack([x, x]), np.array([1.0]), np.array([0.2, 0.8]), np.array([0.2, 0.8]))
    found = program.compiled().solve(np.zeros(1))
    assert found.status == "Not_Enough_Degrees_Of_Freedom" and found.iterations == 0 and not found.success
