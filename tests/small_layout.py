"""A layout that is solved in a second and known in closed form: two round tables about the two-joint robot.

Both stand 0.9 m from the robot's axis and may be moved about it alone. They come as near to each other as their discs
allow, so that the revolute joint turns by ``2 asin(0.2 / 0.9)`` there and back.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

TURN_RAD = 2.0 * math.asin(0.2 / 0.9)
SPEED_RAD_S = 1.5
CYCLE_S = 2.0 * TURN_RAD / SPEED_RAD_S


def table(name: str, **changes: Any) -> dict[str, Any]:
    """Return the station of one round table."""
    return {
        "name": name,
        "harness": {
            "joints": [
                {"name": "around", "turn": "z", "range": ["-150 deg", "150 deg"]},
                {"offset": {"position": ["0.9 m", "0 m", "0 m"]}},
            ]
        },
        "hull": [{"sphere": {"radius": "0.2 m"}, "pose": {"position": ["0 m", "0 m", "0.2 m"]}}],
        "approaches": [{"pose": {"position": ["0 m", "0 m", "0.5 m"]}, "target": "position"}],
        **changes,
    }


def document(**changes: Any) -> dict[str, Any]:
    """Return the layout file as plain data."""
    return {
        "cellwright": 1,
        "name": "two tables",
        "robot": {"model": "pr_robot", "hull": {"model": "point", "tool_radius": "20 mm", "base_radius": "0.2 m"}},
        "stations": [table("blue"), table("red")],
        "solver": {"starts": 2},
        **changes,
    }


def write_layout(folder: Path, **changes: Any) -> Path:
    """Write the layout file."""
    path = folder / "layout.yaml"
    path.write_text(yaml.safe_dump(document(**changes), sort_keys=False))
    return path
