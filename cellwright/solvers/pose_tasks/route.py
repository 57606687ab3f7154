"""The sequence in which a robot performs its tasks: the cheapest order and alternatives, motions planned lazily.

Bjorkenstam 2014, section 2.1: solve the generalised travelling-salesman problem on lower bounds, plan the motions of
the sequence, put their true costs in, and again, until the bound proves that nothing else can win or the work is
spent. Where a cost guesses as well, because its bounds say little, the sequence that guesses lead to is found first and
the bounds prove what they can of it. What is proven then may be little, so a second bound is measured: what no sequence
undercuts as long as no other motion is cheaper, against its guess, than the cheapest of those planned. Two plainer
orders are planned beside it for comparison: the tasks as they are listed, and always the nearest next.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InfeasibleError, listed
from cellwright.solvers.gtsp.guided import guessed, ratios, search_guided
from cellwright.solvers.gtsp.known_costs import KnownCosts
from cellwright.solvers.gtsp.lazy import solve_known
from cellwright.solvers.gtsp.problem import SequencingProblem, Stop
from cellwright.solvers.motion_cost import GuessedCost, MotionCost, PlannedMotions
from cellwright.solvers.pose_tasks.alternatives import Alternative
from cellwright.solvers.pose_tasks.task import PoseTask
from cellwright.solvers.sequencing import solve_sequence

START, END = "start", "end"
LISTED, NEAREST, FOUND = "as listed", "nearest next", "sequence"
"""The orders that are compared."""
LIKELY_ROUNDS = 4_000
"""Rounds of search for the likely bound: as many as a proof asks for, since its sequence is not taken."""


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


@dataclass(frozen=True)
class LikelyBound:
    """What no sequence undercuts if no motion is cheaper, against its guess, than those that were planned.

    Attributes:
        value: The bound; never below the proven one.
        least_ratio: The least true cost over guess among the motions planned, rounded down to hundredths.
        n_motions: How many these are.
    """

    value: float
    least_ratio: float
    n_motions: int


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
        likely: A bound that is likely and not proven; None where the cost does not guess.
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
    likely: LikelyBound | None

    @property
    def cost(self) -> float:
        """What the sequence costs."""
        return self.orders[FOUND]

    @property
    def gap(self) -> float:
        """Share of the cost by which the bound stays below it."""
        return max(0.0, 1.0 - self.lower_bound / self.cost) if self.cost > 0 else 0.0

    @property
    def likely_bound(self) -> float | None:
        """What no sequence undercuts if no motion costs less than `least_ratio` of its guess; None without guesses."""
        return None if self.likely is None else self.likely.value

    @property
    def least_ratio(self) -> float | None:
        """The least true cost over guess among the motions planned; None without guesses."""
        return None if self.likely is None else self.likely.least_ratio


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
        InfeasibleError: If no sequence is found whose motions all exist, or none before a limit is met.
    """
    costs = [each.stroke for each in alternatives] if strokes is None else list(strokes)
    problem, motions = _problem(tasks, alternatives, costs, start, cost, rules)
    search = _Search(problem, motions, work, stop, progress)
    try:
        found = search.run(rng)
    except InfeasibleError as error:
        raise InfeasibleError(_no_way(problem, motions, tasks, str(error))) from error
    compared = {name: order for name in (LISTED, NEAREST) if (order := _plain_order(problem, motions, name, tasks))}
    best = min((found.best, *compared.values()), key=lambda order: order.cost)  # the work may be too little to search
    likely = search.likely_bound(best, found, rng)
    return _route(problem, motions, found, best, compared, likely, len(alternatives))


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
        self.known = KnownCosts(problem, self._evaluate, symmetric=motions.cost.symmetric)
        self.guess: FloatArray | None = None

    def run(self, rng: np.random.Generator) -> _Found:
        """Return the best sequence found."""
        start = None
        if isinstance(self.motions.cost, GuessedCost) and self.problem.n_clusters > 1:
            self.guess = np.maximum(self.motions.cost.guess(self.motions.q), 0.0)
            most = self.work.max_motions
            guided = search_guided(self.known, self.guess, rng, max_evaluations=most, stop=self.stop)
            start = guided.nodes if len(guided.nodes) else None
        lazy = solve_known(
            self.known, rng, start=start, target_gap=self.work.target_gap, max_evaluations=self.work.max_motions,
            max_work=self.work.max_work, stop=self.stop,
        )  # fmt: skip
        result = lazy.result
        best = Order(tuple(result.nodes.tolist()), result.cost)
        return _Found(best, result.lower_bound, result.proven, result.stopped_by, lazy.n_evaluated, lazy.n_motions)

    def likely_bound(self, best: Order, found: _Found, rng: np.random.Generator) -> LikelyBound | None:
        """Return what no sequence undercuts if guesses are no worse than on the motions planned, all of them."""
        if self.guess is None:
            return None
        for a, b in sorted(self.motions.found):  # the orders compared have planned some more
            self.known.put(a, b, self.motions.evaluate(a, b))
        told = ratios(self.known, self.guess)
        if not len(told):
            return None
        # what is told is what is assumed, so it is rounded before it is used
        least, value = math.floor(100.0 * float(told.min())) / 100.0, min(found.lower_bound, best.cost)
        if not found.proven:
            likely = guessed(self.known, least * self.guess)
            proof = solve_sequence(
                likely, rng, n_rounds=LIKELY_ROUNDS, max_work=self.work.max_work, known=[best.nodes], stop=self.stop
            )
            value = max(value, min(proof.lower_bound, best.cost))
        return LikelyBound(value, least, len(told))

    def _evaluate(self, a: int, b: int) -> float:
        self.progress(min(0.9, 0.9 * (self.known.n_evaluated + 1) / max(1, self.work.max_motions)))
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
    best: Order,
    compared: dict[str, Order],
    likely: LikelyBound | None,
    n_alternatives: int,
) -> Route:
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
        likely,
    )


def _no_way(problem: SequencingProblem, motions: PlannedMotions, tasks: Sequence[PoseTask], otherwise: str) -> str:
    """Say which tasks no motion leads to."""
    cut_off = _cut_off(problem, motions)
    if not cut_off or len(cut_off) == len(problem.clusters):
        return f"no sequence of the {len(tasks)} tasks has a motion for every way: {otherwise}"
    return (
        f"no collision-free motion was found between {listed([repr(problem.names[row]) for row in cut_off])} and any "
        f"other place, {len(motions.found)} motions tried: raise roadmap_nodes or max_alternatives, lower "
        "clearance_m, give more approach_m or more room around them, or choose another start_rad"
    )


def _cut_off(problem: SequencingProblem, motions: PlannedMotions) -> list[int]:
    """Return the fewest clusters, more or less, that explain which motions are missing: those missing most first."""
    owner = problem.cluster_of()
    led = {int(owner[v]) for pair, found in motions.found.items() if found is not None for v in pair}
    missing = {frozenset(map(int, owner[list(pair)])) for pair, found in motions.found.items() if found is None}
    cut_off: list[int] = []
    while True:
        open_ = [pair for pair in missing if not pair & set(cut_off)]
        count = {row: sum(row in pair for pair in open_) for row in range(problem.n_clusters) if row not in led}
        if not any(count.values()):
            return sorted(cut_off)
        most = max(count.values())
        cut_off += [row for row, own in count.items() if own == most]
