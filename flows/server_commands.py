"""The commands ``cellwright server start | stop | status``."""

from __future__ import annotations

import sys

from flows import server
from flows.output import write_json
from flows.progress import stage_progress


def run(action: str, *, as_json: bool) -> int:
    """Start, stop or look at the server, print what was found, and return the exit code.

    Raises:
        ServerError: If the server does not start.
    """
    if action == "stop":
        stopped = server.stop()
        if as_json:
            write_json({"stopped": stopped})
        else:
            sys.stdout.write("stopped\n" if stopped else "no server was running\n")
        return 0
    with stage_progress(quiet=as_json) as (_, say):
        found = server.start(say) if action == "start" else server.status()
    if as_json:
        write_json(found.as_json())
    elif found.state == "stopped":
        sys.stdout.write(f"stopped (its data: {found.home})\n")
    else:
        process = f", process {found.pid}" if found.pid else ""
        sys.stdout.write(f"{found.state}: {found.ui_url}{process} (its data: {found.home})\n")
    return 0
