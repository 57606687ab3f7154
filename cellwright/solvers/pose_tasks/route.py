"""The sequence in which a robot performs its tasks: the cheapest order and alternatives, motions planned lazily.

Bjorkenstam 2014, section 2.1: solve the generalised travelling-salesman problem on lower bounds, plan the motions of
the sequence, put their true costs in, and again, until the bound proves that nothing else can win or the work is
spent. Where a cost guesses as well, because its bounds say little, the sequence that guesses lead to is found first and
the bounds prove what they can of it. Two plainer orders are planned beside it for comparison: the tasks as they are
listed, and always the nearest next.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InfeasibleError, listed
from cellwright.solvers.gtsp.guided import search_guided
from cellwright.solvers.gtsp.lazy import solve_lazily
from cellwright.solvers.gtsp.problem import SequencingProblem, Stop
from cellwright.solvers.motion_cost import GuessedCost, MotionCost, PlannedMotions
from cellwright.solvers.pose_tasks.alternatives import Alternative
from cellwright.solvers.pose_tasks.task import PoseTask
from cellwright.solvers.sequencing import solve_sequence

START, END = "start", "end"
LISTED, NEAREST, FOUND = "as listed", "nearest next", "sequence"
"""The orders that are compared."""
PROVEN = 1e-9
"""Share of a cost by which a bound may stay below it and prove it: rounding."""


@dataclass(frozen=True)
class RouteRules:
    """What a sequence has to respect.

    Attributes:
        from_start: Whether it begins at the start configuration.
        returns: Whether it comes back to where it began.
        end: Configuration at which it ends, if it is given; then it does not return.
        before: Pairs (i, j) of tasks: i somewhere before j.
    """

    from_start: bool = True
    returns: bool = True
    end: tuple[float, ...] | None = None
    before: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class RouteWork:
    """How much work goes into it: motions to plan at most, the gap that is good enough, and work of each proof."""

    max_motions: int = 2000
    target_gap: float = 0.0
    max_work: float | None = None


@dataclass(frozen=True, eq=False)
class Order:
    """A sequence of nodes (alternatives, and the start or end configuration) and what it costs."""

    nodes: tuple[int, ...]
    cost: float


@dataclass(frozen=True, eq=False)
class Route:
    """The sequence and how good it is.

    Attributes:
        stops: Rows of ``alternatives`` in order.
        orders: Costs by the order's name; infinite where an order has a way without motion.
        lower_bound: No sequence of these alternatives costs less.
        proven: Whether none can be cheaper.
        stopped_by: What ended the work: ``proof``, ``gap``, ``evaluations``, ``work``, ``memory`` or ``stop``.
        n_evaluated: Motions planned before the sequence was known, of ``n_motions`` that there are.
        motions: The planned motions, which hold those of the sequence.
        nodes: The sequence as nodes of ``motions``.
        closed: Whether a motion leads from its last node to its first.
    """

    stops: tuple[int, ...]
    orders: dict[str, float]
    lower_bound: float
    proven: bool
    stopped_by: str
    n_evaluated: int
    n_motions: int
    motions: PlannedMotions
    nodes: tuple[int, ...]
    closed: bool

    @property
    def cost(self) -> float:
        """What the sequence costs."""
        return self.orders[FOUND]

    @property
    def gap(self) -> float:
        """Share of the cost by which the bound stays below it."""
        return max(0.0, 1.0 - self.lower_bound / self.cost) if self.cost > 0 else 0.0


def find_route(
    tasks: Sequence[PoseTask],
    alternatives: Sequence[Alternative],
    start: FloatArray,
    cost: MotionCost,
    rules: RouteRules,
    work: RouteWork,
    rng: np.random.Generator,
    *,
    strokes: Sequence[float] | None = None,
    stop: Stop | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Route:
    """Return the cheapest sequence found, with a lower bound.

    Args:
        tasks: The tasks.
        alternatives: Their alternatives, each task at least one.
        start: The start configuration, (joints,) in rad.
        cost: What motions cost.
        rules: What the sequence has to respect.
        work: How much work goes into it.
        rng: Where the search gets its random numbers from.
        strokes: What one stroke of each alternative costs; its time if left out.
        stop: Ends the work early when it returns true.
        progress: Told the share of the motions that may be planned.

    Raises:
        InvalidInputError: If what comes before what contradicts itself.
        InfeasibleError: If no sequence is found whose motions all exist.
    """
    costs = [each.stroke for each in alternatives] if strokes is None else list(strokes)
    problem, motions = _problem(tasks, alternatives, costs, start, cost, rules)
    search = _Search(problem, motions, work, stop, progress)
    try:
        found = search.run(rng)
    except InfeasibleError as error:
        raise InfeasibleError(_no_way(problem, motions, tasks, str(error))) from error
    compared = {name: order for name in (LISTED, NEAREST) if (order := _plain_order(problem, motions, name, tasks))}
    return _route(problem, motions, found, compared, len(alternatives))


@dataclass(frozen=True, eq=False)
class _Found:
    """The best sequence of a search and what is proven of it."""

    best: Order
    lower_bound: float
    proven: bool
    stopped_by: str
    n_evaluated: int
    n_motions: int


class _Search:
    """The search for a sequence: by guesses if there are any, then by bounds."""

    def __init__(
        self,
        problem: SequencingProblem,
        motions: PlannedMotions,
        work: RouteWork,
        stop: Stop | None,
        progress: Callable[[float], None],
    ) -> None:
        self.problem, self.motions, self.work, self.stop, self.progress = problem, motions, work, stop, progress
        self.asked: set[tuple[int, int]] = set()

    def run(self, rng: np.random.Generator) -> _Found:
        """Return the best sequence found."""
        cost, problem, first = self.motions.cost, self.problem, None
        if isinstance(cost, GuessedCost) and problem.n_clusters > 1:
            guess = np.maximum(cost.guess(self.motions.q), 0.0)
            guided = search_guided(
                problem, guess, self._evaluate, rng, symmetric=cost.symmetric,
                max_evaluations=self.work.max_motions, stop=self.stop,
            )  # fmt: skip
            if len(guided.nodes):
                first = Order(tuple(guided.nodes.tolist()), guided.cost)
                problem = replace(problem, cost=guided.known)
        lazy = solve_lazily(
            problem, self._evaluate, rng, symmetric=cost.symmetric, target_gap=self.work.target_gap,
            max_evaluations=self.work.max_motions if first is None else None, max_work=self.work.max_work,
            stop=self.stop if first is None else self._is_over,
        )  # fmt: skip
        best = Order(tuple(lazy.result.nodes.tolist()), lazy.result.cost)
        if first is None:
            result = lazy.result
            return _Found(best, result.lower_bound, result.proven, result.stopped_by, lazy.n_evaluated, lazy.n_motions)
        if first.cost < best.cost:
            best = first
        bound, stopped_by = lazy.result.lower_bound, lazy.result.stopped_by
        if stopped_by == "stop":  # which ended the proof too: what is known by now proves more
            known = replace(self.problem, cost=lazy.cost)
            proof = solve_sequence(known, rng, max_work=self.work.max_work, known=[best.nodes], stop=self.stop)
            bound, stopped_by = max(bound, proof.lower_bound), "evaluations"
        bound = min(bound, best.cost)
        proven = bound >= best.cost * (1.0 - PROVEN)
        return _Found(best, bound, proven, stopped_by, len(self.asked), lazy.n_motions)

    def _is_over(self) -> bool:
        return len(self.asked) >= self.work.max_motions or (self.stop is not None and self.stop())

    def _evaluate(self, a: int, b: int) -> float:
        self.asked.add((min(a, b), max(a, b)) if self.motions.cost.symmetric else (a, b))
        self.progress(min(0.9, 0.9 * len(self.asked) / max(1, self.work.max_motions)))
        return self.motions.evaluate(a, b)


def _problem(
    tasks: Sequence[PoseTask],
    alternatives: Sequence[Alternative],
    strokes: Sequence[float],
    start: FloatArray,
    cost: MotionCost,
    rules: RouteRules,
) -> tuple[SequencingProblem, PlannedMotions]:
    """Return the problem on lower bounds: a cluster a task, then one for the start and one for a given end."""
    rows = [np.empty(0, np.int32) for _ in tasks]
    for task in range(len(tasks)):
        rows[task] = np.array([k for k, each in enumerate(alternatives) if each.task == task], np.int32)
    q = [each.q_entry for each in alternatives]
    at_work = [
        2.0 * stroke + float(cost.holding(each.q_task, tasks[each.task].dwell))
        for each, stroke in zip(alternatives, strokes, strict=True)
    ]
    first = last = None
    names = [task.name for task in tasks]
    for word, where in ((START, start if rules.from_start else None), (END, rules.end)):
        if where is not None:
            first, last = (len(rows), last) if word == START else (first, len(rows))
            rows.append(np.array([len(q)], np.int32))
            q.append(np.array(where, float))
            at_work.append(0.0)
            names.append(f"the {word}")
    motions = PlannedMotions(cost, np.stack(q))
    problem = SequencingProblem(
        motions.bounds, tuple(rows), np.array(at_work), rules.returns and rules.end is None, first, last,
        rules.before, tuple(names),
    )  # fmt: skip
    return problem, motions


def _plain_order(
    problem: SequencingProblem, motions: PlannedMotions, name: str, tasks: Sequence[PoseTask]
) -> Order | None:
    """Return the order as listed, or that of the nearest next, its alternatives each the nearest; none if barred."""
    first = [] if problem.start is None else [problem.start]
    last = [] if problem.end is None else [problem.end]
    needs: dict[int, set[int]] = {row: set() for row in range(len(tasks))}
    for before, after in problem.before:
        needs[after].add(before)
    nodes = [int(problem.clusters[row][0]) for row in first]
    left = list(range(len(tasks)))
    while left:
        ready = [row for row in left if not needs[row] & set(left)]
        wanted = left[:1] if name == LISTED else ready
        if not set(wanted) <= set(ready):
            return None  # the list itself breaks what must come before what
        found = _nearest_way(problem, motions, nodes[-1] if nodes else None, wanted)
        if found is None:
            return None
        row, node = found
        left.remove(row)
        nodes.append(node)
    nodes += [int(problem.clusters[row][0]) for row in last]
    total = math.fsum(float(problem.service[node]) for node in nodes)
    return Order(tuple(nodes), total + math.fsum(motions.evaluate(a, b) for a, b in problem.legs(nodes)))


def _nearest_way(
    problem: SequencingProblem, motions: PlannedMotions, at: int | None, wanted: Sequence[int]
) -> tuple[int, int] | None:
    """Return task and alternative of the nearest that a motion leads to, by bounds; the first one without a place."""
    if at is None:
        return wanted[0], int(problem.clusters[wanted[0]][0])
    nodes = np.concatenate([problem.clusters[row] for row in wanted])
    rows = np.repeat(wanted, [len(problem.clusters[row]) for row in wanted])
    for place in np.lexsort((nodes, rows, problem.cost[at, nodes] + problem.service[nodes])).tolist():
        if math.isfinite(motions.evaluate(at, int(nodes[place]))):
            return int(rows[place]), int(nodes[place])
    return None


def _route(
    problem: SequencingProblem,
    motions: PlannedMotions,
    found: _Found,
    compared: dict[str, Order],
    n_alternatives: int,
) -> Route:
    best = found.best
    for order in compared.values():  # where the work was too little for the search
        if order.cost < best.cost:
            best = order
    closed = problem.closed and len(best.nodes) > 1
    for a, b in problem.legs(best.nodes):
        motions.evaluate(a, b)
    return Route(
        tuple(node for node in best.nodes if node < n_alternatives),
        {**{name: order.cost for name, order in compared.items()}, FOUND: best.cost},
        min(found.lower_bound, best.cost),
        found.proven,
        found.stopped_by,
        found.n_evaluated,
        found.n_motions,
        motions,
        best.nodes,
        closed,
    )


def _no_way(problem: SequencingProblem, motions: PlannedMotions, tasks: Sequence[PoseTask], otherwise: str) -> str:
    """Say which tasks no motion leads to."""
    led = {node for (a, b), found in motions.found.items() if found is not None for node in (a, b)}
    tried = {node for pair in motions.found for node in pair}
    cut_off = [
        f"{problem.names[row]!r}"
        for row, own in enumerate(problem.clusters)
        if set(own.tolist()) & tried and not set(own.tolist()) & led
    ]
    if not cut_off or len(cut_off) == len(problem.clusters):
        return f"no sequence of the {len(tasks)} tasks has a motion for every way: {otherwise}"
    return (
        f"no collision-free motion was found to {listed(cut_off)} from any other task: raise roadmap_nodes or "
        "max_alternatives, lower clearance_m, give more approach_m, or more room around them"
    )
