"""Stitch sweeps into one timed plan: order, direction, alternative of each, and the motions between them.

Kaiser 2021, section 4.4, with three additions: an order that is proven shortest where there are few sweeps; a
confirmation of every motion of the chosen orders in steps of a bounded displacement (what it rejects is barred and
the orders are sought again, so the result is confirmed as a whole); and sweeps that cannot be executed or connected
are left out with their reasons instead of failing the plan.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.errors import SolverError
from cellwright.solvers.connections import first_collision
from cellwright.solvers.path_timing import least_time
from cellwright.solvers.stitched_plan import LeftOut, StitchedPlan, StitchedSegment, StitchSettings
from cellwright.solvers.sweeps.access import NamingChecker, SweepAccess
from cellwright.solvers.sweeps.alternatives import PathKey, SweepOption
from cellwright.solvers.sweeps.order import (
    SAME,
    ConnectionCosts,
    SweepOptions,
    SweepOrder,
    order_best,
    order_greedily,
)
from cellwright.solvers.sweeps.planned import PlannedSweep

Progress = Callable[[float], None]

TRACING = 0.2
"""Share of the progress that tracing and timing the sweeps stands for."""


def stitch(
    cell: Cell,
    checker: NamingChecker,
    sweeps: Sequence[PlannedSweep],
    *,
    settings: StitchSettings,
    method: str,
    rng: np.random.Generator,
    sweep_checker: NamingChecker | None = None,
    progress: Progress = lambda share: None,
) -> StitchedPlan:
    """Return the shortest plan of the orders that ``method`` asks for: ``best``, ``exact`` or ``greedy``.

    ``cell`` holds the part; its start configuration is taken as free and within limits. Sweeps are confirmed by
    ``sweep_checker``, the ``checker`` if left out: between the poses at which sweeps were followed they may come a
    little closer to something than at them. A sweep that cannot be executed or connected is left out with its
    reason; the plan may then have no segment at all.

    Raises:
        SolverError: If ``method`` is ``exact`` and the order could not be proven shortest.
    """
    stitcher = _Stitcher(cell, checker, sweep_checker or checker, sweeps, settings, rng, progress)
    orders = stitcher.orders(with_best=method != "greedy")
    progress(1.0)
    n_joints = len(cell.start)
    if not orders:
        return StitchedPlan((), {}, "", 0.0, False, stitcher.left_out(), n_joints)
    preferred = [name for name in orders if (name == "greedy") == (method == "greedy")]
    chosen = preferred[0] if preferred else next(iter(orders))
    order = orders[chosen]
    bound = min(order.duration, max(other.lower_bound for other in orders.values()))
    proven = bound >= order.duration - SAME
    if method == "exact" and not proven:
        raise SolverError(
            f"the order of {len(order.options)} sweeps could not be proven shortest: {order.duration:.2f} s, lower "
            f"bound {bound:.2f} s, gap {1.0 - bound / order.duration:.1%}, stopped after {settings.n_evaluations} "
            "connections: raise max_connections, or use `method` best"
        )
    durations = {name: each.duration for name, each in orders.items()}
    segments = stitcher.segments(order)
    return StitchedPlan(segments, durations, chosen, bound, proven, stitcher.left_out(), n_joints)


class _Stitcher:
    """Orders of the sweeps that can be executed, confirmed motion by motion."""

    def __init__(
        self,
        cell: Cell,
        checker: NamingChecker,
        sweep_checker: NamingChecker,
        sweeps: Sequence[PlannedSweep],
        settings: StitchSettings,
        rng: np.random.Generator,
        progress: Progress,
    ) -> None:
        self._sweep_checker, self._sweeps, self._settings, self._progress = sweep_checker, sweeps, settings, progress
        self._access = SweepAccess(cell, checker, sweeps, settings, rng, lambda share: progress(TRACING * share))
        self._to_go = 1.0 - TRACING
        self._confirmed_paths: set[tuple[int, PathKey]] = set()
        self._left_out: dict[int, str] = {}
        self._current: list[SweepOption] = []
        self._costs: ConnectionCosts

    def orders(self, with_best: bool) -> dict[str, SweepOrder]:
        """Return the orders by name, all their motions confirmed; none if every sweep had to be left out."""
        while True:
            for number in self._hopeless():
                while not self._access.usable(number):
                    if not self._access.revived(number):
                        self._left_out[number] = self._access.reason(number)
                        break
            self._current = [option for number in self._executed() for option in self._access.usable(number)]
            if not self._current:
                return {}
            found = self._confirmed_orders(with_best)
            if found:
                return found

    def left_out(self) -> tuple[LeftOut, ...]:
        """Return the sweeps that are not executed."""
        return tuple(LeftOut(number, self._left_out[number]) for number in sorted(self._left_out))

    def segments(self, order: SweepOrder) -> tuple[StitchedSegment, ...]:
        """Return connections and sweeps in the given order."""
        found: list[StitchedSegment] = []
        at = self._access.start
        for option in (self._current[number] for number in order.options):
            found += [self._connection(at, option.entry)]
            found += [StitchedSegment(option.motion, option.sweep, option.branch, option.direction, "")]
            at = option.exit
        if self._settings.returns:
            found += [self._connection(at, self._access.start)]
        return tuple(found)

    def _connection(self, q_a: FloatArray, q_b: FloatArray) -> StitchedSegment:
        connection = self._access.connections.between(q_a, q_b)
        if connection is None:
            raise SolverError("a confirmed connection is gone: report this as a fault of the planner")
        return StitchedSegment(connection.motion, -1, -1, 0, connection.via)

    def _confirmed_orders(self, with_best: bool) -> dict[str, SweepOrder]:
        """Return orders whose motions are all confirmed; none if a sweep has lost its last option on the way."""
        options = self._sweep_options()
        self._costs = costs = ConnectionCosts(options, self._cost)
        while True:
            greedy = order_greedily(options, costs)
            found = {} if greedy is None else {"greedy": greedy}
            if (with_best or greedy is None) and not self._hopeless():
                best = order_best(
                    options,
                    costs,
                    greedy,
                    exact_up_to=self._settings.exact_up_to,
                    n_evaluations=self._settings.n_evaluations,
                )
                if best is not None:
                    found["exact" if best.proven else "search"] = best
            if self._hopeless():
                return {}
            if not found:
                self._leave_the_loneliest_out()
                return {}
            self._to_go *= 0.5
            self._progress(1.0 - self._to_go)
            confirmed = [self._confirmed(order) for order in found.values()]
            if all(confirmed):
                return found
            if self._hopeless():
                return {}

    def _executed(self) -> list[int]:
        return [number for number in range(len(self._sweeps)) if number not in self._left_out]

    def _hopeless(self) -> list[int]:
        return [number for number in self._executed() if not self._access.usable(number)]

    def _leave_the_loneliest_out(self) -> None:
        """Leave out the sweep with the fewest connections: all can be reached, but no order was found for all."""
        finite = np.isfinite(self._costs.value)
        counts: dict[int, int] = dict.fromkeys(self._executed(), 0)
        for row, option in enumerate(self._current):
            counts[option.sweep] += int(finite[row, :-1].sum() + finite[:-1, row].sum())
        loneliest = min(counts, key=lambda number: (counts[number], -number))
        self._left_out[loneliest] = (
            f"no order was found that connects it with the other {len(counts) - 1} sweeps, on a roadmap of "
            f"{self._access.n_nodes} configurations"
        )

    def _sweep_options(self) -> SweepOptions:
        options, executed = self._current, self._executed()
        counts = [sum(option.sweep == number for option in options) for number in executed]
        entries = np.stack([*(option.entry for option in options), self._access.start])
        exits = np.stack([*(option.exit for option in options), self._access.start])
        return SweepOptions(
            name=tuple(self._sweeps[number].name for number in executed),
            first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
            duration=np.array([option.motion.duration for option in options]),
            reverse=(np.arange(len(options)) ^ 1).astype(np.int32),
            least=least_time(exits[:, None], entries[None], self._access.limits),
            returns=self._settings.returns,
        )

    def _ends(self, a: int, b: int) -> tuple[FloatArray, FloatArray]:
        start = len(self._current)
        return (
            self._access.start if a == start else self._current[a].exit,
            self._access.start if b == start else self._current[b].entry,
        )

    def _cost(self, a: int, b: int) -> float:
        """Return the cost of a connection; take alternatives out that cannot be reached at all."""
        cost = self._access.connections.duration(*self._ends(a, b))
        if np.isinf(cost):
            for number in {a, b} - {len(self._current)}:
                if not self._access.is_reached(self._current[number]):
                    self._costs.bar(number)
                    self._costs.bar(number ^ 1)
        return cost

    def _confirmed(self, order: SweepOrder) -> bool:
        """Confirm all motions of an order; bar or replace what is not free, and say whether nothing was."""
        confirmed, home = True, len(self._current)
        for number in order.options.tolist():
            confirmed &= self._confirmed_sweep(number)
        stops = [home, *order.options.tolist(), *([home] if self._settings.returns else [])]
        for a, b in itertools.pairwise(stops):
            if not self._access.connections.confirm(*self._ends(a, b)):
                self._costs.set(a, b, self._cost(a, b))
                confirmed = False
        return confirmed

    def _confirmed_sweep(self, number: int) -> bool:
        option = self._current[number]
        key = option.sweep, option.path
        if key in self._confirmed_paths:
            return True
        steps = self._settings.confirm_step, self._settings.confirm_angle
        collision = first_collision(self._sweep_checker, self._access.corners, option.motion, *steps)
        if collision is None:
            self._confirmed_paths.add(key)
            return True
        moment, q = collision
        bodies = " and ".join(self._sweep_checker.colliding_pair(q) or ())
        self._access.bar_path(option, f"branch {option.branch}: {bodies} after {moment:.3f} s")
        for row, other in enumerate(self._current):
            if (other.sweep, other.path) == key:
                self._costs.bar(row)
        return False
