"""Where libraries may keep what they prepare once: in cellwright's own state folder, not in the user's home."""

from __future__ import annotations

import os

from flows.server import state_home


def use_own_caches() -> None:
    """Send ssik's preparation of an arm (seconds to minutes, once an arm) to the state folder; what is set stays.

    Without a folder that can be written ssik works all the same, and prepares again each time.
    """
    os.environ.setdefault("SSIK_DERIVATION_CACHE", str(state_home() / "caches" / "ssik"))
