"""Compile the numerical kernels once, by planning the example coarsely: ``python -m flows.compile_kernels``.

The example's sweeps are few enough that their choice is proven without a search, so a harder one is made besides; its
arm has a closed form, so the paths of one without are followed besides.

Numba compiles a kernel when it is first called and keeps the result beside the module (or in the user's cache folder
where that is not writable). Set-up does it, so that nobody waits for it in a first plan.
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellwright.arrays import BoolArray, FloatArray


def main() -> int:
    """Plan in memory; every stage runs once."""
    import numpy as np

    from cellwright.cell.parametric_parts import box
    from cellwright.solvers import sequencing
    from cellwright.solvers.set_cover import cover_best
    from cellwright.solvers.spheres.fitting import FitSettings, fit_spheres
    from flows import inspection
    from flows.examples import find_cell_file

    sys.stderr.write("compiling the numerical kernels (once, about a minute) ...\n")
    begun = time.monotonic()
    coarse = (
        *("planner.sampling.density=0.0008 /mm^2", "planner.refinement.rounds=1"),
        *("layout.evaluations=20", "layout.stitched=1"),
    )
    inspection.run(find_cell_file("grooved_cylinder"), overrides=coarse, lake="memory://kernels", direct=True)
    cover_best(_strips_on_cylinder(80, 500))
    fit_spheres(box((0.1, 0.1, 0.1)), 3, generator=np.random.default_rng(0), settings=FitSettings(n_starts=1))
    sequencing.compile_kernels()
    follow_calibrated_arm()
    sys.stderr.write(f"compiled in {time.monotonic() - begun:.0f} s\n")
    return 0


def follow_calibrated_arm() -> FloatArray:
    """Follow a short path with an arm that is off by what calibration finds, so that only elimination solves it."""
    import numpy as np

    from cellwright.cell.branch_tracking import solve_paths
    from cellwright.cell.built_in_robots import built_in_robot
    from cellwright.cell.inverse_kinematics import inverse_kinematics_for
    from cellwright.cell.robot import Chain
    from cellwright.cell.transforms import pose, rotation_from_rpy

    nominal = built_in_robot("ur10e").chain
    tilt = pose(np.zeros(3), rotation_from_rpy(1e-3, 1e-3, -1e-3))
    chain = Chain(nominal.T_parent_joint @ tilt, nominal.axis, nominal.T_last_flange, *(np.ones(6),) * 4)
    solver = inverse_kinematics_for(chain)
    T = np.tile(nominal.T_parent_joint[0], (12, 1, 1))
    T[:, :3, 3] = np.stack([np.linspace(0.6, 0.65, 12), np.full(12, 0.2), np.full(12, 0.4)], axis=1)
    return solve_paths(solver.solve, chain, T, np.array([0, len(T)]))


def _strips_on_cylinder(n_samples: int, n_views: int) -> BoolArray:
    """Return which strips in random directions on an unrolled cylinder hold which points: hard to choose from."""
    import numpy as np

    rng = np.random.default_rng(1)
    angle, height = rng.uniform(0, 2 * np.pi, n_samples), rng.uniform(0, 0.2, n_samples)
    centre, turn = rng.integers(0, n_samples, n_views), rng.uniform(0, np.pi, n_views)
    aside = (angle[:, None] - angle[centre] + np.pi) % (2 * np.pi) - np.pi
    across, up = 0.06 * np.sin(aside), height[:, None] - height[centre]
    along, off = across * np.cos(turn) + up * np.sin(turn), up * np.cos(turn) - across * np.sin(turn)
    return np.asarray((np.abs(aside) < 0.96) & (np.abs(off) < 0.03) & (np.abs(along) < 0.06))


if __name__ == "__main__":
    sys.exit(main())
