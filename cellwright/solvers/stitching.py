"""Stitch sweeps into one timed plan: order, direction, alternative of each, and the motions between them.

Kaiser 2021, section 4.4, with two additions: an order that is proven shortest where there are few sweeps, and a
confirmation of every motion of the chosen orders in steps of a bounded displacement. What confirmation rejects is
barred and the orders are sought again, so the result is confirmed as a whole.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import track_pose
from cellwright.errors import InfeasibleError, SolverError
from cellwright.solvers.connections import Connections, ConnectionSteps, first_collision
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.path_timing import Limits, TimedMotion, least_time
from cellwright.solvers.planned_sweep import PlannedSweep
from cellwright.solvers.roadmap import CollisionChecker, Roadmap, RoadmapSize
from cellwright.solvers.sweep_alternatives import (
    TRACKING_STEPS,
    TRACKING_TOLERANCE,
    SweepPath,
    flange_targets,
    nearest_windings,
    trace_sweep,
)
from cellwright.solvers.sweep_order import (
    ConnectionCosts,
    SweepOptions,
    SweepOrder,
    order_best,
    order_greedily,
)

ROADMAP_MARGIN = 1.0
"""Rad by which the roadmap reaches beyond the ends of all sweeps: detours are wider than what they connect."""
RETREATS = (0.06, 0.15)
"""Metres to back off along the viewing axis from the ends of sweeps: nodes from which the part is no obstacle."""


class NamingChecker(CollisionChecker, Protocol):
    """A scene that can say what collides."""

    def colliding_pair(self, q: FloatArray, /) -> tuple[str, str] | None:
        """Return the names of two bodies that collide at ``q`` (joints,) in rad, ``None`` if none do."""
        ...


Progress = Callable[[float], None]


@dataclass(frozen=True)
class StitchSettings:
    """How sweeps are stitched; SI units.

    Attributes:
        scan_speed, tool_acceleration: Limits of the travel on sweeps.
        sample: Time between states.
        trace_step: Travel between traced poses.
        step: Largest joint turn between checked states while searching.
        confirm_step, confirm_angle: Furthest motion of any point, largest joint turn while confirming.
        max_alternatives: Branches and windings tried of each sweep.
        roadmap: Size of the roadmap.
        exact_up_to: Most sweeps for the exact order.
        n_evaluations: Connections that the best order may evaluate.
        returns: Whether the plan ends where it starts.
    """

    scan_speed: float = 0.1
    tool_acceleration: float = 1.0
    sample: float = 0.008
    trace_step: float = 0.002
    step: float = 0.02
    confirm_step: float = 1e-3
    confirm_angle: float = 0.01
    max_alternatives: int = 8
    roadmap: RoadmapSize = field(default_factory=RoadmapSize)
    exact_up_to: int = 15
    n_evaluations: int = 1000
    returns: bool = False


@dataclass(frozen=True, eq=False)
class StitchedSegment:
    """A sweep (``sweep`` its number) or a connection (``sweep`` -1); a sweep's motion has the travel as last column."""

    motion: TimedMotion
    sweep: int
    branch: int
    direction: int
    via: str


@dataclass(frozen=True, eq=False)
class StitchedPlan:
    """Segments in order, and the duration in s of the plan in every order that was compared."""

    segments: tuple[StitchedSegment, ...]
    durations: dict[str, float]
    chosen: str


@dataclass(frozen=True, eq=False)
class _Option:
    """One way to execute a sweep: a timed branch with turns added, forwards or backwards."""

    sweep: int
    path: int
    motion: TimedMotion
    branch: int
    direction: int

    @property
    def entry(self) -> FloatArray:
        return self.motion.position[0, :-1]

    @property
    def exit(self) -> FloatArray:
        return self.motion.position[-1, :-1]


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
    little closer to something than at them.

    Raises:
        InfeasibleError: If a sweep cannot be executed or connected; it names the sweep.
    """
    stitcher = _Stitcher(cell, checker, sweep_checker or checker, sweeps, settings, rng, progress)
    orders = stitcher.orders(with_best=method != "greedy")
    chosen = method if method == "greedy" else next(name for name in orders if name != "greedy")
    durations = {name: order.duration for name, order in orders.items()}
    progress(1.0)
    return StitchedPlan(stitcher.segments(orders[chosen]), durations, chosen)


class _Stitcher:
    """The options of all sweeps, the connections between them, and what confirmation has barred."""

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
        self._cell, self._checker, self._sweep_checker = cell, checker, sweep_checker
        self._sweeps, self._settings, self._progress = sweeps, settings, progress
        chain = cell.robot.chain
        self._limits = Limits(chain.max_velocity, chain.max_acceleration)
        self._start = np.array(cell.start, float)
        self._options: list[_Option] = []
        for number in range(len(sweeps)):
            self._options += self._options_of(number)
            progress(0.2 * (number + 1) / len(sweeps))
        roadmap_rng, shortening_rng = rng.spawn(2)
        roadmap = self._roadmap(roadmap_rng)
        steps = ConnectionSteps(settings.step, settings.sample, settings.confirm_step, settings.confirm_angle)
        self._corners = MovingCorners.of(cell)
        self._connections = Connections(checker, roadmap, self._corners, self._limits, steps, shortening_rng)
        self._confirmed_paths: set[tuple[int, int]] = set()
        self._barred_paths: dict[tuple[int, int], str] = {}

    def orders(self, with_best: bool) -> dict[str, SweepOrder]:
        """Return the orders by name, all their motions confirmed."""
        options = self._sweep_options()
        costs = ConnectionCosts(options, self._cost)
        to_go = 0.8
        while True:
            found = {"greedy": order_greedily(options, costs)}
            if with_best:
                best = order_best(
                    options,
                    costs,
                    found["greedy"],
                    exact_up_to=self._settings.exact_up_to,
                    n_evaluations=self._settings.n_evaluations,
                )
                found["exact" if best.proven else "search"] = best
            to_go *= 0.5
            self._progress(1.0 - to_go)
            confirmed = [self._confirmed(order, costs) for order in found.values()]
            if all(confirmed):
                return found

    def segments(self, order: SweepOrder) -> tuple[StitchedSegment, ...]:
        """Return connections and sweeps in the given order."""
        found: list[StitchedSegment] = []
        current = self._start
        for option in (self._options[number] for number in order.options):
            found += [self._connection(current, option.entry)]
            found += [StitchedSegment(option.motion, option.sweep, option.branch, option.direction, "")]
            current = option.exit
        if self._settings.returns:
            found += [self._connection(current, self._start)]
        return tuple(found)

    def _connection(self, q_a: FloatArray, q_b: FloatArray) -> StitchedSegment:
        connection = self._connections.between(q_a, q_b)
        if connection is None:
            raise SolverError("a confirmed connection is gone: report this as a fault of the planner")
        return StitchedSegment(connection.motion, -1, -1, 0, connection.via)

    def _options_of(self, number: int) -> list[_Option]:
        """Trace, time and wind the pieces of one sweep."""
        sweep, settings, chain = self._sweeps[number], self._settings, self._cell.robot.chain
        paths: list[SweepPath] = []
        for piece in sweep.pieces:
            path = trace_sweep(
                self._cell, sweep.T_world_scanner, piece.q_start, piece.branch, piece.start, sweep.interval,
                settings.trace_step,
            )  # fmt: skip
            if path is not None:
                paths.append(path)
        chosen = nearest_windings(paths, chain, self._start, settings.max_alternatives)
        motions: dict[int, TimedMotion] = {}
        for path_number in sorted({path_number for path_number, _ in chosen}):
            try:
                motions[path_number] = paths[path_number].timed(
                    self._limits, settings.scan_speed, settings.tool_acceleration, settings.sample
                )
            except SolverError:
                continue  # another branch may have a timing
        options = []
        for path_number, turns in chosen:
            if path_number not in motions:
                continue
            base = motions[path_number]
            wound = TimedMotion(base.time, base.position + np.append(turns, 0.0), base.velocity, base.acceleration)
            branch = paths[path_number].branch
            options.append(_Option(number, path_number, wound, branch, 1))
            options.append(_Option(number, path_number, wound.reversed(), branch, -1))
        if not options:
            raise InfeasibleError(
                f"{sweep.name}: none of its {len(sweep.pieces)} pieces could be traced and timed over "
                f"{sweep.interval[0] * 1e3:.1f} to {sweep.interval[1] * 1e3:.1f} mm within the joint limits: "
                "follow the sweeps with a smaller step or a lower scan speed"
            )
        return options

    def _roadmap(self, rng: np.random.Generator) -> Roadmap:
        """Make the roadmap around all ends of sweeps, with nodes that back off from them."""
        chain = self._cell.robot.chain
        ends = np.stack([self._start, *(option.entry for option in self._options)])
        lower = np.maximum(chain.lower, ends.min(axis=0) - ROADMAP_MARGIN)
        upper = np.minimum(chain.upper, ends.max(axis=0) + ROADMAP_MARGIN)
        roadmap = Roadmap(
            self._checker,
            lower,
            upper,
            self._limits.velocity,
            size=self._settings.roadmap,
            rng=rng,
        )
        roadmap.seed(self._retreats())
        return roadmap

    def _retreats(self) -> FloatArray:
        """Return configurations behind the ends of the sweeps, (n, joints)."""
        chain = self._cell.robot.chain
        found = []
        for option in self._options:
            T_world_scanner = self._sweeps[option.sweep].T_world_scanner
            q = option.entry
            for retreat in RETREATS:
                T = T_world_scanner.copy()
                T[:3, 3] -= retreat * T[:3, 2]
                target = flange_targets(self._cell, T, option.motion.position[:1, -1])[0]
                q, reached = track_pose(
                    chain.T_parent_joint, chain.axis, chain.T_last_flange, np.ascontiguousarray(q), target,
                    TRACKING_TOLERANCE, TRACKING_STEPS,
                )  # fmt: skip
                if not reached or np.any(q < chain.lower) or np.any(q > chain.upper):
                    break
                found.append(q)
        return np.array(found).reshape(-1, chain.n_joints)

    def _sweep_options(self) -> SweepOptions:
        options = self._options
        counts = np.bincount([option.sweep for option in options], minlength=len(self._sweeps))
        entries = np.stack([*(option.entry for option in options), self._start])
        exits = np.stack([*(option.exit for option in options), self._start])
        return SweepOptions(
            name=tuple(sweep.name for sweep in self._sweeps),
            first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
            duration=np.array([option.motion.duration for option in options]),
            reverse=(np.arange(len(options)) ^ 1).astype(np.int32),
            least=least_time(exits[:, None], entries[None], self._limits),
            returns=self._settings.returns,
        )

    def _ends(self, a: int, b: int) -> tuple[FloatArray, FloatArray]:
        start = len(self._options)
        return (
            self._start if a == start else self._options[a].exit,
            self._start if b == start else self._options[b].entry,
        )

    def _cost(self, a: int, b: int) -> float:
        return self._connections.duration(*self._ends(a, b))

    def _confirmed(self, order: SweepOrder, costs: ConnectionCosts) -> bool:
        """Confirm all motions of an order; bar or replace what is not free, and say whether nothing was."""
        confirmed = True
        for number in order.options.tolist():
            confirmed &= self._confirmed_sweep(number, costs)
        stops = [len(self._options), *order.options.tolist(), *([len(self._options)] if self._settings.returns else [])]
        for a, b in itertools.pairwise(stops):
            if not self._connections.confirm(*self._ends(a, b)):
                costs.set(a, b, self._cost(a, b))
                confirmed = False
        return confirmed

    def _confirmed_sweep(self, number: int, costs: ConnectionCosts) -> bool:
        option = self._options[number]
        key = option.sweep, option.path
        if key in self._confirmed_paths:
            return True
        if key not in self._barred_paths:
            steps = self._settings.confirm_step, self._settings.confirm_angle
            collision = first_collision(self._sweep_checker, self._corners, option.motion, *steps)
            if collision is None:
                self._confirmed_paths.add(key)
                return True
            moment, q = collision
            bodies = " and ".join(self._sweep_checker.colliding_pair(q) or ())
            self._barred_paths[key] = f"branch {option.branch}: {bodies} after {moment:.3f} s"
        own = [i for i, other in enumerate(self._options) if (other.sweep, other.path) == key]
        for i in own:
            costs.bar(i)
        if all(
            (other.sweep, other.path) in self._barred_paths for other in self._options if other.sweep == option.sweep
        ):
            where = "; ".join(text for (sweep, _), text in self._barred_paths.items() if sweep == option.sweep)
            raise InfeasibleError(
                f"{self._sweeps[option.sweep].name} comes closer than the clearance on every branch "
                f"({where}): follow the sweeps with the same clearance_m as they are stitched with"
            )
        return False
