"""Throw compiled kernels away when any module with kernels has changed.

Numba keeps a compiled kernel as long as the file that defines it stays the same, also when a kernel that it calls from
another file has changed: after an update of a checkout stale code would run. A fingerprint of all modules with
kernels, kept beside the cache, makes the whole cache as old as its newest module. Costs a few milliseconds.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

_FINGERPRINT = "kernels.fingerprint"
_KERNEL_MARK = b"njit"


def discard_stale_kernels(package: Path) -> int:
    """Delete the compiled kernels below ``package`` if a module there has changed; return how many files went.

    Where the folder cannot be written, numba keeps its cache elsewhere and nothing is done: installed packages change
    as a whole.
    """
    contents = {path: path.read_bytes() for path in sorted(package.rglob("*.py"))}
    whole = hashlib.sha256()
    for path, content in contents.items():
        if _KERNEL_MARK in content:
            whole.update(f"{path.relative_to(package)}\0{len(content)}\0".encode() + content)
    fingerprint = whole.hexdigest()
    record = package / "__pycache__" / _FINGERPRINT
    with contextlib.suppress(FileNotFoundError, PermissionError):
        if record.read_text() == fingerprint:
            return 0
    n_discarded = 0
    try:
        record.parent.mkdir(exist_ok=True)
        for pattern in ("*.nbi", "*.nbc"):
            for compiled in package.rglob(f"__pycache__/{pattern}"):
                compiled.unlink(missing_ok=True)
                n_discarded += 1
        beside = record.with_name(f"{_FINGERPRINT}.{os.getpid()}")
        beside.write_text(fingerprint)
        beside.replace(record)
    except OSError:
        # a read-only or full disk: there is nothing to keep in order, and kernels compile all the same
        return n_discarded
    return n_discarded
