"""Tell the person which line of the cell file mends an error: stages know parameters only, not where they come from.

A stage's message names the fields of its parameters (``clearance_m``, plain words in backticks); here they become the
cell file's keys, and the values that these keys have are written behind the message, so that it ends in something that
can be edited.
"""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator
from typing import Any

from cellwright.errors import CellwrightError
from cellwright.quantities import format_quantity
from schemas.cell_file import CellFile
from schemas.cell_file_fields import Quantity, Section

KEYS = {
    "start_rad": "robot.start",
    "lower_rad": "robot.lower",
    "upper_rad": "robot.upper",
    "max_velocity": "robot.max_velocity",
    "max_velocity_rad_s": "robot.max_velocity",
    "max_acceleration": "robot.max_acceleration",
    "max_acceleration_rad_s2": "robot.max_acceleration",
    "ignored_pairs": "may_touch",
    "points_per_profile": "scanner.points_per_profile",
    "profile_rate_hz": "scanner.profile_rate",
    "density_per_m2": "planner.sampling.density",
    "critical_angle_rad": "planner.sampling.critical_angle",
    "standoff_m": "planner.viewpoints.standoffs",
    "delta_rot_rad": "planner.viewpoints.delta_rot",
    "theta_tilt_rad": "planner.viewpoints.theta_tilt",
    "psi_tilt_rad": "planner.viewpoints.psi_tilt",
    "max_uncertainty_m": "planner.measurability.max_uncertainty",
    "step_m": "planner.reachability.step",
    "margin_m": "planner.reachability.margin",
    "shortest_m": "planner.reachability.shortest",
    "scan_speed_m_s": "planner.reachability.scan_speed",
    "clearance_m": "planner.reachability.clearance",
    "min_coverage": "planner.selection.min_coverage",
    "max_work": "planner.selection.max_work",
    "node_limit": "planner.selection.node_limit",
    "time_limit_s": "planner.selection.time_limit",
    "max_connections": "planner.stitching.max_connections",
    "exact_up_to": "planner.stitching.exact_up_to",
    "roadmap_nodes": "planner.stitching.roadmap_nodes",
    "neighbours": "planner.stitching.neighbours",
    "max_alternatives": "planner.stitching.max_alternatives",
    "step_rad": "planner.stitching.step",
    "tool_acceleration_m_s2": "planner.stitching.tool_acceleration",
    "return_to_start": "planner.stitching.return_to_start",
    "radius_m": "planner.scan.coverage_radius",
    "T_world_part": "part.pose.position",
    "cost": "sequencing.cost",
    "max_motions": "sequencing.max_motions",
    "n_steps": "sequencing.steps",
    "target_gap": "sequencing.target_gap",
    "payload_kg": "sequencing.payload.mass",
}
"""The cell file's key by the field of stage parameters that it fills; one name means one key in all stages."""

METHODS = {"select_views": "planner.selection.method", "stitch_sweeps": "planner.stitching.method"}
"""The key of the field ``method``, the one name that two stages have."""

_FIELD = re.compile(r"`(\w+)`|(?<![\w.])(\w+_\w+)(?![\w.(])|(?<![\w.])(\w+_\w+)(?=\.(?:\s|$))")
_KEY = re.compile(
    r"(?<![\w./])(?:(?:robot|scanner|part|table|planner|sequencing)(?:\.[a-z_]+)+|may_touch)(?![\w/]|\.\w)"
)


def with_keys(error: CellwrightError, cell: CellFile, stage: str = "") -> CellwrightError:
    """Return the error with keys of the cell file in place of parameters, and their values behind the message."""
    keys = {**KEYS, "method": METHODS.get(stage, "method")}
    text = _FIELD.sub(lambda found: keys.get(found[1] or found[2] or found[3], found[0]), str(error))
    values = {key: value for key in _KEY.findall(text) for value in _values(cell, key)}
    if values:
        listed = "; ".join(f"{key} = {value}" for key, value in values.items())
        text = f"{text} (in {cell.path}: {listed})"
    if text == str(error):
        return error
    told = type(error)(text)
    vars(told).update(vars(error))  # its notes, and the moment at which a plan fails
    return told


def _values(cell: CellFile, key: str) -> Iterator[str]:
    """Yield the value of a key as people write it; nothing for what is no single value, or no key at all."""
    section: Section = cell
    given = True
    *path, last = key.split(".")
    for name in path:
        found = _named(section, name)
        if found is None or not isinstance(value := getattr(section, found), Section):
            return
        section, given = value, given and found in section.model_fields_set
    found = _named(section, last)
    if found is None or isinstance(value := getattr(section, found), Section):
        return
    field = type(section).model_fields[found]
    note = "" if given and found in section.model_fields_set else " by default"
    yield f"{_written(value, _quantity([*field.metadata, field.annotation]))}{note}"


def _named(section: Section, key: str) -> str | None:
    fields = type(section).model_fields.items()
    return next((name for name, field in fields if (field.alias or name) == key), None)


def _quantity(annotations: list[Any]) -> Quantity | None:
    for each in annotations:
        if isinstance(each, Quantity):
            return each
        metadata = getattr(each, "__metadata__", ())
        if (inner := _quantity([*metadata, *typing.get_args(each)])) is not None:
            return inner
    return None


def _written(value: Any, quantity: Quantity | None) -> str:
    if value is None:
        return "not set"
    if isinstance(value, tuple):
        return f"[{', '.join(_written(each, quantity) for each in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and quantity is not None:
        return format_quantity(value, quantity.dimension)
    return str(value)
