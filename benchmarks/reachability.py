"""How long does it take to follow all sweeps? Run: ``python -m benchmarks.reachability [density per mm^2]``.

The shipped example at the paper's highest density: a UR10e with a scanner before a grooved cylinder on a pedestal,
about 20,000 sweeps, after one run at a low density that pays for compilation and imports. Beside the stage stand the
bare kernels of the same run on exactly the items that it gave them: poses solved, forward kinematics, collision
checks. Processor seconds tell on a busy machine.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.planning_chain import LOW_DENSITY, Chain, Scene, tallied

STAGE = "follow_sweeps"
RAYS = "rays cast"


def main(density_per_mm2: float) -> None:
    """Print what the stage found, what it took, and what its bare kernels take."""
    scene = Scene.example()
    Chain(scene, LOW_DENSITY)
    chain = Chain(scene, density_per_mm2)
    reached, processor = chain.reached, chain.processor_s[STAGE]
    print(f"{len(chain.views.sample)} sweeps: {chain.wall_s[STAGE]:.2f} s ({processor:.2f} s processor)   (bar 6 s)")
    print(f"  {len(np.unique(reached.view))} can be executed, {len(reached.view)} pieces")
    print(f"  exact checks {reached.n_exact_checks}, left unsettled {reached.n_unsettled}")
    tally, _ = tallied(scene, density_per_mm2)
    del tally.count[RAYS], tally.seconds[RAYS]
    tally.show()
    print(f"  ratio to the bare kernels: {processor / tally.total_s:.2f}")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 0.01)
