"""Which versions made a result: noted beside it, in no key, so that an upgrade recomputes nothing by itself."""

from __future__ import annotations

import functools
import platform
from importlib.metadata import PackageNotFoundError, version

_DISTRIBUTIONS = {
    "cellwright": "cellwright",
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "pinocchio": "pin",
    "coal": "coal",
    "python-fcl": "python-fcl",
    "highspy": "highspy",
    "open3d": "open3d",
    "casadi": "casadi",
}
"""Our own package and those that decide numbers, by what people call them, with the names they are installed by."""


@functools.cache
def versions() -> dict[str, str]:
    """Return the versions of Python, of cellwright and of the libraries that decide numbers, as installed."""
    found = {"python": platform.python_version()}
    for name, distribution in _DISTRIBUTIONS.items():
        try:
            found[name] = version(distribution)
        except PackageNotFoundError:
            found[name] = "unknown"  # run from a checkout, or installed by other means than a package
    return found
