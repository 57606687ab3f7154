#!/usr/bin/env bash
# Make .venv with everything that requirements.lock names, and cellwright itself in editable form.
# Does nothing when that has been done for this lock, this pyproject.toml and this Python.
set -euo pipefail
cd "$(dirname "$0")/.."

fail() {
    printf 'error: %s\n' "$1" >&2
    exit 1
}

find_python() {
    local candidate found=""
    for candidate in ${PYTHON:-python3.11 python3.12 python3}; do
        command -v "$candidate" >/dev/null || continue
        "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 13))' 2>/dev/null && {
            printf '%s\n' "$candidate"
            return
        }
        found="$found $candidate ($("$candidate" -c 'import platform; print(platform.python_version())' 2>&1 | tail -n 1))"
    done
    fail "Python 3.11 or 3.12 is needed, found:${found:- none}: install python3.11, or name one by PYTHON=..."
}

# what must be there before pip can do its work, as Debian packages
missing_packages() {
    "$1" - <<'PYTHON'
import ctypes
import importlib.util
import sys

needed = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libgomp.so.1": "libgomp1",
}
missing = []
if not all(importlib.util.find_spec(name) for name in ("venv", "ensurepip")):
    missing.append("python{}.{}-venv".format(*sys.version_info[:2]))
if sys.platform == "linux":
    for library, package in needed.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(package)
print(*missing)
PYTHON
}

install_missing() {
    local missing output
    missing=$(missing_packages "$1")
    [ -n "$missing" ] || return 0
    if [ "$(id -u)" != 0 ]; then
        fail "system packages are missing; install them with: sudo apt-get install $missing"
    elif ! command -v apt-get >/dev/null; then
        fail "system packages are missing (names as in Debian), install them first: $missing"
    fi
    printf 'installing %s\n' "$missing"
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086  # several words on purpose
    output=$({ apt-get update -qq && apt-get install -y -qq --no-install-recommends $missing; } 2>&1) ||
        fail "apt-get could not install $missing: $(tail -n 5 <<<"$output")"
    missing=$(missing_packages "$1")
    [ -z "$missing" ] || fail "still missing after apt-get: $missing"
}

# uv with its hashes, cut out of the lock: pip installs it, it installs the rest, many times faster
locked_uv() {
    awk '/^[^ ]/ { inside = /^uv==/ } inside' requirements.lock
}

fingerprint() {
    cat requirements.lock pyproject.toml scripts/set_up.sh <("$1" -VV) | sha256sum
}

main() {
    local python stamp
    stamp=.venv/.set_up
    python=$(find_python)
    if [ -x .venv/bin/cellwright ] && [ "$(cat "$stamp" 2>/dev/null)" = "$(fingerprint "$python")" ]; then
        return
    fi
    rm -f "$stamp"
    install_missing "$python"
    if ! .venv/bin/python -m pip --version >/dev/null 2>&1 && ! .venv/bin/uv --version >/dev/null 2>&1 ||
        [ "$(.venv/bin/python -VV 2>/dev/null)" != "$("$python" -VV)" ]; then
        printf 'making .venv with %s\n' "$("$python" -V)"
        "$python" -m venv --clear .venv
    fi
    if ! .venv/bin/uv --version >/dev/null 2>&1; then
        .venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r <(locked_uv)
    fi
    printf 'installing the locked packages (several gigabytes the first time) ...\n'
    .venv/bin/uv pip sync --quiet --python .venv/bin/python --require-hashes requirements.lock || {
        printf 'uv could not install them, trying pip, which is slower\n' >&2
        .venv/bin/python -m ensurepip >/dev/null
        .venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
    }
    .venv/bin/uv pip install --quiet --python .venv/bin/python --no-deps --no-build-isolation --editable .
    .venv/bin/python -m flows.compile_kernels
    fingerprint "$python" >"$stamp" # anew: apt-get may have brought a newer patch release of Python
}

main
