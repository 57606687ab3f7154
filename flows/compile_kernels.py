"""Compile the numerical kernels once, by planning the example coarsely: ``python -m flows.compile_kernels``.

Numba compiles a kernel when it is first called and keeps the result beside the module (or in the user's cache folder
where that is not writable). Set-up does it, so that nobody waits for it in a first plan.
"""

from __future__ import annotations

import sys
import time


def main() -> int:
    """Plan in memory; every stage runs once."""
    from flows import inspection
    from flows.examples import find_cell_file

    sys.stderr.write("compiling the numerical kernels (once, about a minute) ...\n")
    begun = time.monotonic()
    coarse = ("planner.sampling.density=0.0008 /mm^2", "planner.refinement.rounds=1")
    inspection.run(find_cell_file("grooved_cylinder"), overrides=coarse, lake="memory://kernels", direct=True)
    sys.stderr.write(f"compiled in {time.monotonic() - begun:.0f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
