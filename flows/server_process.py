"""Become the local Prefect server: take the lock, write down who holds it, then turn into the server.

Run as ``python server_process.py HOME PORT``. The process number does not change on ``exec`` and the open, locked
file goes along, so that ``HOME/server.json`` is locked exactly as long as the server lives, and names it. It is run
by its path, and so imports the standard library only.
"""

from __future__ import annotations

import fcntl
import json
import os
import sys
import time
from pathlib import Path


def main(home: Path, port: int) -> None:
    """Never returns; ends with exit code 75 if another server of this home is alive."""
    record = os.open(home / "server.json", os.O_RDWR | os.O_CREAT, 0o600)
    for _ in range(40):
        try:
            fcntl.flock(record, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except BlockingIOError:  # a status command looks at the lock for a moment
            time.sleep(0.05)
    else:
        sys.exit(75)
    os.ftruncate(record, 0)
    os.write(record, json.dumps({"pid": os.getpid(), "port": port}).encode())
    os.set_inheritable(record, True)
    server = ["-m", "prefect", "server", "start", "--host", "127.0.0.1", "--port", str(port)]
    os.execv(sys.executable, [sys.executable, *server])


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
