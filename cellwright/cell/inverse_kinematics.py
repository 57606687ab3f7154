"""Inverse kinematics with every branch, each one certified by forward kinematics.

The solver is chosen by the chain's geometry: our closed form for three parallel axes (Universal Robots), EAIK's
subproblem decompositions (spherical wrists and others; Ostermeier et al. 2025), crx-kinematics for offset wrists,
elimination (`cellwright.cell.general_arm`) for any other six-axis arm, and ssik for what that leaves out. A solver is
taken only if it finds back the configurations that random poses were made from. Every candidate is polished by
Newton's method and dropped unless its flange pose is within 1e-6 m and 1e-6 rad of the asked one.

Cost a pose with certification: 4 us closed form, 10 us EAIK, 25 us offset wrist, 0.3 ms for each variant of the
elimination that the arm needs (two to five), milliseconds by ssik, which also takes up to a minute once per geometry
(it keeps its derivation in the user's cache folder). Solvers that slow are asked at a few poses of a path only, see
`cellwright.cell.branch_tracking`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell import general_arm, offset_wrist, parallel_axes
from cellwright.cell.axis_frames import axes_at_zero
from cellwright.cell.chain_kinematics import (
    flange_poses,
    jacobian,
    link_poses_into,
    multiply_into,
    pose_error_into,
    track_pose,
)
from cellwright.cell.dependent_axes import singular_fault
from cellwright.cell.robot import Chain
from cellwright.errors import InvalidInputError

PARALLEL_AXES = "three parallel axes"
OFFSET_WRIST = "offset wrist"
ELIMINATION = "general six-axis, by elimination"
GENERAL = "general six-axis"
CERTIFIED = 1e-6
"""Largest error of a returned branch, in m and in rad."""
_POLISHED = 2e-9
"""Branches this close (m, rad) are not polished: rounded right angles of published URDFs cost up to 1e-9."""
_NEAR = 1e-3
"""Candidates farther from the pose than this (m, rad) are least-squares answers, not rounding: dropped unpolished."""
_MOST_POLISH = 0.1
"""Polishing that turns a joint farther than this (rad) has left the candidate for another solution."""
_SAME = 1e-5
"""Configurations that differ by less than this in every joint are one branch, rad."""
_TRIALS = 60
_MORE_TRIALS = 400
"""For the elimination, which loses a branch of one pose in a hundred before an arm has the variants that it needs."""
_REGULAR = 1e-3
"""Trials whose Jacobian has a singular value below this (m, rad) do not count there: roots run together."""
_FEWEST_REGULAR = 200
"""With fewer trials left the elimination counts as not fitting: what is lost once in a hundred poses must show."""

Candidates = Callable[[FloatArray], FloatArray]
"""Poses (n, 4, 4) to candidate configurations (n, branches, 6), NaN rows where there are fewer."""


@dataclass(frozen=True, eq=False)
class InverseKinematics:
    """Every configuration of a six-axis arm for a flange pose.

    Attributes:
        family: The kinematic family and with it the solver.
        n_branches: Rows that `solve` returns a pose.
        chain: The arm.
        parallel_axes_geometry: For `cellwright.cell.parallel_axes.branches_into`; None outside that family.
    """

    family: str
    n_branches: int
    chain: Chain
    candidates: Candidates
    parallel_axes_geometry: FloatArray | None = None

    def solve(self, T_base_flange: FloatArray) -> FloatArray:
        """Return all branches (n, n_branches, 6) in rad, wrapped to (-pi, pi], of flange poses (n, 4, 4).

        Rows without solution are NaN; joint limits are not looked at (see `windings`). With three parallel axes
        a row is a posture and keeps its place along a path, with gaps; in all other families the rows are
        sorted by their angles and must be matched along a path by the nearest one.

        Raises:
            InvalidInputError: If the poses are not (n, 4, 4) or not finite.
        """
        poses = np.ascontiguousarray(T_base_flange, float)
        if poses.ndim != 3 or poses.shape[1:] != (4, 4):
            raise InvalidInputError(f"flange poses have shape {poses.shape}: give (n, 4, 4)")
        if not np.isfinite(poses).all():
            raise InvalidInputError("a flange pose has a value that is not finite")
        if not len(poses):
            return np.empty((0, self.n_branches, self.chain.n_joints))
        found = np.ascontiguousarray(self.candidates(poses))
        chain = self.chain
        certify(chain.T_parent_joint, chain.axis, chain.T_last_flange, poses, found)
        return found if self.family == PARALLEL_AXES else _sorted(found, self.n_branches)

    @property
    def slow(self) -> bool:
        """Whether a pose takes so long that a path is better followed from a few solved poses."""
        return self.family in (ELIMINATION, GENERAL)


def inverse_kinematics_for(chain: Chain) -> InverseKinematics:
    """Choose and try out the solver for an arm.

    Raises:
        InvalidInputError: If the arm has not six joints, is singular in every configuration, or no solver finds its
            random configurations back.
    """
    if chain.n_joints != 6:
        raise InvalidInputError(
            f"the arm has {chain.n_joints} joints: every-branch inverse kinematics needs six; "
            "choose base and flange links with six joints between them"
        )
    if (fault := singular_fault(chain)) is not None:
        raise InvalidInputError(fault)
    tried: list[str] = []
    for make in (_by_parallel_axes, _by_eaik, _by_offset_wrist, _by_elimination, _by_ssik):
        solver = make(chain)
        if solver is not None:
            shortfall = _shortfall(solver)
            if shortfall is None:
                return solver
            tried.append(f"{solver.family}: {shortfall}")
    raise InvalidInputError(
        f"no inverse kinematics solver fits this arm ({'; '.join(tried)}): check the joint axes and origins in its URDF"
    )


def windings(q: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return all configurations (m, joints) that differ from ``q`` (joints,) by full turns and keep the limits.

    Sorted by the number of turns, first joint first; none if a joint has no value within its limits.
    """
    turns = []
    for value, low, high in zip(q.tolist(), lower.tolist(), upper.tolist()):
        first = math.ceil((low - value) / (2.0 * math.pi) - 1e-12)
        last = math.floor((high - value) / (2.0 * math.pi) + 1e-12)
        turns.append([value + 2.0 * math.pi * k for k in range(first, last + 1)])
    found = np.array(list(itertools.product(*turns)), float).reshape(-1, len(turns))
    return np.asarray(np.clip(found, lower, upper))


@numba.njit(cache=True, nogil=True)
def _error_at(
    T_parent_joint: FloatArray,
    axis: FloatArray,
    T_last_flange: FloatArray,
    q: FloatArray,
    T_base_flange: FloatArray,
    links: FloatArray,
    T: FloatArray,
    error: FloatArray,
) -> float:
    """Return the larger of position (m) and rotation (rad) error at ``q``; NaN where ``q`` is not finite.

    The last three arguments are work space.
    """
    for joint in range(len(q)):
        if not math.isfinite(q[joint]):
            return math.nan
    link_poses_into(T_parent_joint, axis, q, links)
    multiply_into(links[len(q)], T_last_flange, T)
    pose_error_into(T, T_base_flange, error)
    distance = math.sqrt(error[0] * error[0] + error[1] * error[1] + error[2] * error[2])
    angle = math.sqrt(error[3] * error[3] + error[4] * error[4] + error[5] * error[5])
    return max(distance, angle)


@numba.njit(cache=True, nogil=True)
def certify(
    T_parent_joint: FloatArray,
    axis: FloatArray,
    T_last_flange: FloatArray,
    T_base_flange: FloatArray,
    candidates: FloatArray,
) -> None:
    """Polish candidates (n, branches, joints) in place, wrap them to (-pi, pi], and NaN what is wrong or double."""
    n_joints = candidates.shape[2]
    links, T, error = np.empty((n_joints + 1, 4, 4)), np.empty((4, 4)), np.empty(6)
    for row in range(len(candidates)):
        for branch in range(candidates.shape[1]):
            q = candidates[row, branch]
            worst = _error_at(T_parent_joint, axis, T_last_flange, q, T_base_flange[row], links, T, error)
            if _POLISHED < worst <= _NEAR:
                polished, _ = track_pose(T_parent_joint, axis, T_last_flange, q, T_base_flange[row], 1e-11, 5)
                after = _error_at(T_parent_joint, axis, T_last_flange, polished, T_base_flange[row], links, T, error)
                moved = 0.0
                for joint in range(n_joints):
                    moved = max(moved, abs(polished[joint] - q[joint]))
                if after < worst and moved < _MOST_POLISH:
                    q[:] = polished
                    worst = after
            if not worst <= CERTIFIED:
                q[:] = math.nan
                continue
            for joint in range(n_joints):
                wrapped = q[joint] - 2.0 * math.pi * math.ceil(q[joint] / (2.0 * math.pi) - 0.5)
                q[joint] = wrapped if wrapped > -math.pi else math.pi
            for other in range(branch):
                same = True
                for joint in range(n_joints):
                    apart = abs(candidates[row, other, joint] - q[joint])
                    if not min(apart, 2.0 * math.pi - apart) < _SAME:
                        same = False
                        break
                if same:
                    q[:] = math.nan
                    break


def _sorted(found: FloatArray, n_branches: int) -> FloatArray:
    """Sort the branches of each pose by their angles, NaN rows last, and keep ``n_branches`` of them."""
    keys = np.round(found, 6)
    order = np.lexsort(tuple(keys[..., joint] for joint in reversed(range(found.shape[2]))), axis=-1)
    return np.take_along_axis(found, order[..., None], axis=1)[:, :n_branches]


def _shortfall(solver: InverseKinematics) -> str | None:
    """Say how many random configurations the solver does not find back from their poses; None if it finds all."""
    chain = solver.chain
    generator = np.random.default_rng(0)
    q = generator.uniform(-math.pi, math.pi, (_MORE_TRIALS if solver.family == ELIMINATION else _TRIALS, 6))
    if solver.family == ELIMINATION:
        J = np.array([jacobian(chain.T_parent_joint, chain.axis, chain.T_last_flange, row) for row in q])
        regular = np.linalg.svd(J, compute_uv=False)[:, -1] > _REGULAR
        q = q[regular]
        if len(q) < _FEWEST_REGULAR:
            return f"only {len(q)} of {_MORE_TRIALS} random configurations are far enough from singular ones to tell"
    poses = flange_poses(chain.T_parent_joint, chain.axis, chain.T_last_flange, q)
    found = solver.solve(poses)
    apart = np.abs(np.remainder(found - q[:, None] + math.pi, 2.0 * math.pi) - math.pi).max(axis=2)
    missed = int(np.count_nonzero(~(apart < 1e-4).any(axis=1)))
    return f"{missed} of {len(q)} not found" if missed else None


def _by_parallel_axes(chain: Chain) -> InverseKinematics | None:
    geometry = parallel_axes.parallel_axes_geometry(chain)
    if geometry is None:
        return None

    def candidates(poses: FloatArray) -> FloatArray:
        found: FloatArray = parallel_axes.branches(geometry, poses)
        return found

    return InverseKinematics(PARALLEL_AXES, parallel_axes.N_BRANCHES, chain, candidates, geometry)


def _by_eaik(chain: Chain) -> InverseKinematics | None:
    from eaik.pybindings import EAIK

    H, P, R = _exponentials(chain)
    # rounded right angles (1e-10) are neither parallel nor crossing to EAIK: snapped, and mended by polishing
    H = np.round(H, 8)
    try:
        robot: Any = EAIK.Robot((H / np.linalg.norm(H, axis=1, keepdims=True)).T, np.round(P, 8).T, R, [], True)
    except RuntimeError:  # raised for some geometries outside its families
        return None
    if not robot.has_known_decomposition():
        return None

    def candidates(poses: FloatArray) -> FloatArray:
        # without a solution Q has shape (0, 0)
        return _stacked([np.reshape(solution.Q, (-1, 6)) for solution in robot.calculate_IK_batched(list(poses), 2)])

    return InverseKinematics(str(robot.get_kinematic_family()), 8, chain, candidates)


def _by_offset_wrist(chain: Chain) -> InverseKinematics | None:
    geometry = offset_wrist.offset_wrist(chain)
    if geometry is None:
        return None
    solver = offset_wrist.OffsetWristSolver(geometry)
    return InverseKinematics(OFFSET_WRIST, offset_wrist.N_BRANCHES, chain, solver.candidates)


def _by_elimination(chain: Chain) -> InverseKinematics:
    """Take as many variants of the arm as find every trial back, and one to spare; all but that one if none do."""
    arms = general_arm.variants(chain)
    for count in range(1, len(arms)):
        if _shortfall(_eliminating(chain, arms[:count])) is None:
            return _eliminating(chain, arms[: count + 1])
    return _eliminating(chain, arms[:-1])


def _eliminating(chain: Chain, arms: list[general_arm.GeneralArm]) -> InverseKinematics:
    def candidates(poses: FloatArray) -> FloatArray:
        return general_arm.candidates(chain, arms, poses)

    return InverseKinematics(ELIMINATION, general_arm.N_BRANCHES, chain, candidates)


def _by_ssik(chain: Chain) -> InverseKinematics:
    import ssik

    H, P, R = _exponentials(chain)
    arm: Any = ssik.Manipulator.from_axes(H, P)
    T_flange_last = np.eye(4)
    T_flange_last[:3, :3] = R.T

    def candidates(poses: FloatArray) -> FloatArray:
        found = [
            [solution.q for solution in arm.solve(T @ T_flange_last, respect_limits=False, allow_refinement=True)]
            for T in poses
        ]
        return _stacked([np.array(rows).reshape(-1, 6) for rows in found])

    return InverseKinematics(GENERAL, 16, chain, candidates)


def _exponentials(chain: Chain) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return axes H (6, 3), offsets P (7, 3) between points on them, and the flange's rotation, at q = 0."""
    h, p, T_base_flange = axes_at_zero(chain)
    points = np.vstack([np.zeros((1, 3)), p, T_base_flange[None, :3, 3]])
    return h, np.diff(points, axis=0), T_base_flange[:3, :3].copy()


def _stacked(rows: list[FloatArray]) -> FloatArray:
    width = max([16, *(len(solutions) for solutions in rows)])
    found = np.full((len(rows), width, 6), np.nan)
    for row, solutions in enumerate(rows):
        found[row, : len(solutions)] = solutions
    return found
