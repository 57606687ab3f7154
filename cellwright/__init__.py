"""Cellwright's pure library: the modelled robot cell (`cell`) and the planning algorithms (`solvers`).

It knows no lake and no Prefect, keeps no state, and takes its random generators as arguments. All that it writes is
the cache of its compiled kernels.
"""

from pathlib import Path

from cellwright.kernel_cache import discard_stale_kernels

discard_stale_kernels(Path(__file__).parent)
