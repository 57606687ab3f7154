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


def gripper_urdf(*, mesh: str = "") -> str:
    """Return a two-joint arm, 0.7 m high, whose hand carries two sliding fingers beyond the flange.

    The fingers move on joints of their own, which no layout moves: at zero they stand 10 mm apart. With ``mesh`` that
    is the first arm's collision geometry.
    """

    def link(name: str, geometry: str, xyz: str) -> str:
        return f'<link name="{name}"><collision><origin xyz="{xyz}"/><geometry>{geometry}</geometry></collision></link>'

    def joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str, limit: str) -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
            f'<axis xyz="{axis}"/><limit {limit} velocity="1.5" effort="1"/></joint>'
        )

    turning, sliding = 'lower="-2.9" upper="2.9"', 'lower="0" upper="0.04"'
    first = f'<mesh filename="{mesh}"/>' if mesh else '<box size="0.5 0.06 0.06"/>'
    parts = [
        link("column", '<cylinder radius="0.06" length="0.6"/>', "0 0 0.3"),
        link("upper", first, "0.3 0 0"),
        link("fore", '<box size="0.4 0.06 0.06"/>', "0.25 0 0"),
        link("hand", '<box size="0.06 0.16 0.06"/>', "0 0 0"),
        link("left", '<box size="0.1 0.02 0.02"/>', "0.08 0.015 0"),
        link("right", '<box size="0.1 0.02 0.02"/>', "0.08 -0.015 0"),
        joint("shoulder", "revolute", "column", "upper", "0 0 0.7", "0 0 1", turning),
        joint("elbow", "revolute", "upper", "fore", "0.6 0 0", "0 0 1", turning),
        joint("wrist", "fixed", "fore", "hand", "0.5 0 0", "0 0 1", turning),
        joint("open left", "prismatic", "hand", "left", "0 0 0", "0 1 0", sliding),
        joint("open right", "prismatic", "hand", "right", "0 0 0", "0 -1 0", sliding),
    ]
    return f'<robot name="gripping">{"".join(parts)}</robot>'


def gripping(**changes: Any) -> dict[str, Any]:
    """Return the changes that put that arm (``arm.urdf``) among tables that it reaches over."""
    above = [{"pose": {"position": ["0 m", "0 m", "0.7 m"]}, "target": "position"}]
    tables = [table(name, approaches=above) for name in ("blue", "red")]
    robot = {"model": "arm.urdf", "flange_link": "hand", "hull": {"spheres": 3}}
    return {"robot": {**robot, **changes}, "stations": tables, "solver": {"starts": 1}}
