"""In which ways can each sweep be executed, and can they be reached from the start configuration?

Options come from tracing and timing; one roadmap, sown with configurations that back off from the ends of sweeps,
connects them. What turns out impossible (a path that collides, an alternative that cannot be reached) is taken out.
Of a sweep that loses its last option, random trees look for a way out of its ends, then further branches and windings
are tried; when nothing helps there is a reason in words.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import track_pose
from cellwright.errors import listed
from cellwright.solvers.connections import Connections, ConnectionSteps
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.path_timing import Limits
from cellwright.solvers.random_trees import connect_by_trees
from cellwright.solvers.roadmap import CollisionChecker, Roadmap
from cellwright.solvers.stitched_plan import StitchSettings
from cellwright.solvers.sweeps.alternatives import (
    TRACKING_STEPS,
    TRACKING_TOLERANCE,
    AlternativeKey,
    PathKey,
    SweepOption,
    SweepSettings,
    flange_targets,
    sweep_options,
)
from cellwright.solvers.sweeps.planned import PlannedSweep

ROADMAP_MARGIN = 1.0
"""Rad by which the roadmap reaches beyond the ends of all sweeps: detours are wider than what they connect."""
RETREATS = (0.06, 0.15)
"""Metres to back off along the viewing axis from the ends of sweeps: nodes from which the part is no obstacle."""

MORE_ALTERNATIVES = 4
"""Times as many alternatives are tried of a sweep that would be left out."""
ESCAPES, TREE_NODES, TREE_STEP = 4, 1500, 0.5
"""Alternatives of a sweep from which random trees seek a way, their nodes, and their step as a share of the search's:
they lead through narrow places, where confirmation would reject coarse steps."""


class NamingChecker(CollisionChecker, Protocol):
    """A scene that can say what collides."""

    def colliding_pair(self, q: FloatArray, /) -> tuple[str, str] | None:
        """Return the names of two bodies that collide at ``q`` (joints,) in rad, ``None`` if none do."""
        ...


class SweepAccess:
    """The options of all sweeps that have not turned out impossible, and the connections between them.

    Attributes:
        limits: Limits of the joints.
        start: The start configuration, (joints,) in rad.
        corners: Corners of boxes around all moving bodies.
        connections: Connections found so far.
    """

    def __init__(
        self,
        cell: Cell,
        checker: CollisionChecker,
        sweeps: Sequence[PlannedSweep],
        settings: StitchSettings,
        rng: np.random.Generator,
        progress: Callable[[float], None],
    ) -> None:
        self._cell, self._checker, self._sweeps, self._settings = cell, checker, sweeps, settings
        chain = cell.robot.chain
        self.limits = Limits(chain.max_velocity, chain.max_acceleration)
        self.start = np.array(cell.start, float)
        self.corners = MovingCorners.of(cell)
        self._options: list[list[SweepOption]] = []
        for number in range(len(sweeps)):
            self._options.append(self._options_of(number, settings.max_alternatives))
            progress((number + 1) / len(sweeps))
        roadmap_rng, shortening_rng, self._tree_rng = rng.spawn(3)
        self._roadmap = self._sown_roadmap(roadmap_rng)
        steps = ConnectionSteps(settings.step, settings.sample, settings.confirm_step, settings.confirm_angle)
        self.connections = Connections(
            checker, self._roadmap, self.corners, self.limits, steps, shortening_rng, hub=self.start
        )
        self._barred_paths: dict[tuple[int, PathKey], str] = {}
        self._unreached: set[tuple[int, AlternativeKey]] = set()
        self._escapes: set[tuple[int, AlternativeKey]] = set()

    @property
    def n_nodes(self) -> int:
        """The number of configurations of the roadmap."""
        return self._roadmap.n_nodes

    def usable(self, number: int) -> list[SweepOption]:
        """Return the options of a sweep that have not turned out impossible."""
        return [
            option
            for option in self._options[number]
            if (number, option.path) not in self._barred_paths and (number, option.alternative) not in self._unreached
        ]

    def bar_path(self, option: SweepOption, reason: str) -> None:
        """Take out all options with the joint path of ``option``."""
        self._barred_paths[option.sweep, option.path] = reason

    def is_reached(self, option: SweepOption) -> bool:
        """Whether both ends of an option are connected with the start configuration; if not, it is taken out."""
        ends = (self.connections.duration(self.start, q) for q in (option.entry, option.exit))
        reached = all(np.isfinite(duration) for duration in ends)
        if not reached:
            self._unreached.add((option.sweep, option.alternative))
        return reached

    def revived(self, number: int) -> bool:
        """Try harder to execute a sweep that has no usable option, and return whether there is more to try now.

        First a way out of the ends of its alternatives by random trees, one after the other; then more alternatives.
        """
        for option in self._options[number][::2]:
            key = number, option.alternative
            tried = sum(each[0] == number for each in self._escapes)
            if key in self._unreached - self._escapes and (number, option.path) not in self._barred_paths:
                if tried == ESCAPES:
                    break
                self._escapes.add(key)
                if self._escapes_from(option):
                    self._unreached.discard(key)
                    self.connections.forget_failures()
                    return True
        known = {option.alternative for option in self._options[number]}
        more = self._options_of(number, MORE_ALTERNATIVES * self._settings.max_alternatives)
        new = [option for option in more if option.alternative not in known]
        self._options[number] += new
        return bool(new)

    def reason(self, number: int) -> str:
        """Return why a sweep has no usable option."""
        sweep, options = self._sweeps[number], self._options[number]
        if not options:
            return (
                f"none of its {len(sweep.pieces)} pieces could be traced and timed over "
                f"{sweep.interval[0] * 1e3:.1f} to {sweep.interval[1] * 1e3:.1f} mm within the joint limits"
            )
        reasons = []
        n_unreached = sum(key[0] == number for key in self._unreached)
        if n_unreached:
            reasons.append(
                f"no collision-free connection was found from the start configuration to {n_unreached} of its "
                f"{len(options) // 2} alternatives, on a roadmap of {self._roadmap.n_nodes} configurations"
            )
        where = [text for (sweep_number, _), text in self._barred_paths.items() if sweep_number == number]
        if where:
            least = self._settings.sweep_clearance
            near = f"bodies come closer than {least * 1e3:.3g} mm" if least > 0.0 else "bodies collide"
            poses = "between the poses at which it was followed"
            reasons.append(f"{near} {poses}, on {len(where)} branches ({listed(where)})")
        return "; ".join(reasons)

    def _escapes_from(self, option: SweepOption) -> bool:
        """Connect both ends of an option with the start configuration by random trees."""
        low, high = self._roadmap.box
        for q in (option.entry, option.exit):
            if np.isfinite(self.connections.duration(self.start, q)):
                continue
            path = connect_by_trees(
                self._checker,
                q,
                self.start,
                (np.minimum(low, q), np.maximum(high, q)),
                self.limits.velocity,
                step=TREE_STEP * self._settings.step,
                n_most=TREE_NODES,
                rng=self._tree_rng,
            )
            if path is None:
                return False
            self._roadmap.seed_path(path, TREE_STEP * self._settings.step)
        return True

    def _options_of(self, number: int, count: int) -> list[SweepOption]:
        s = self._settings
        how = SweepSettings(self.limits, s.scan_speed, s.tool_acceleration, s.sample, s.trace_step)
        return sweep_options(self._cell, self._sweeps[number], number, how, count)

    def _sown_roadmap(self, rng: np.random.Generator) -> Roadmap:
        """Make the roadmap around all ends of sweeps, with nodes that back off from them."""
        chain = self._cell.robot.chain
        options = [option for some in self._options for option in some]
        ends = np.stack([self.start, *(option.entry for option in options)])
        lower = np.maximum(chain.lower, ends.min(axis=0) - ROADMAP_MARGIN)
        upper = np.minimum(chain.upper, ends.max(axis=0) + ROADMAP_MARGIN)
        roadmap = Roadmap(
            self._checker,
            lower,
            upper,
            self.limits.velocity,
            size=self._settings.roadmap,
            rng=rng,
        )
        roadmap.seed(self._retreats(options))
        return roadmap

    def _retreats(self, options: list[SweepOption]) -> FloatArray:
        """Return configurations behind the ends of the sweeps, (n, joints)."""
        chain = self._cell.robot.chain
        found = []
        for option in options:
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
