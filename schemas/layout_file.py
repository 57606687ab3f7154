"""The layout file: robot, stations on harnesses, what the robot does at them, and what stands in the way.

The same house as the cell file of an inspection: quantities with units, one message with file, line, key, value and
mend for up to five faults. `docs/layout-file.md` lists every key.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, ValidationError

from cellwright.cell.built_in_robots import built_in, built_in_urdf
from cellwright.cell.robot import LONGEST_REACH_M
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.urdf_geometry import check_geometry
from cellwright.errors import InvalidInputError
from schemas.cell_file_document import Document, Location, apply_overrides, read_document
from schemas.cell_file_fields import Section, Text
from schemas.cell_file_messages import did_you_mean, faults_of, refusal
from schemas.layout_file_hulls import MOST_SPHERES_IN_ALL, LayoutObstacleSection
from schemas.layout_file_sections import (
    CostSection,
    JointQuantity,
    LayoutRobotSection,
    SolverSection,
    StationSection,
    WallSection,
    WorkspaceSection,
)

FORMAT = 1
"""The version of the layout file that this release reads and writes."""
HOME = "home"
"""The word in a sequence for the robot's home configuration."""
TOOL = "robot tool"
"""What a tool goes by that is no part of the URDF."""
BASE = "robot base"
"""What the robot's base goes by in results."""

Faults = list[tuple[Location, str]]


class LayoutFile(Section):
    """A whole layout file."""

    _path: Path = PrivateAttr(default=Path())

    version: Literal[1] = Field(alias="cellwright", description="Version of the file: 1.", examples=["1"])
    name: Text = Field(description="Name of the cell; the file's name if left out.")
    robot: LayoutRobotSection = Field(default=LayoutRobotSection(), description="The arm.")
    stations: tuple[StationSection, ...] = Field(
        min_length=1, max_length=100, description="What the robot visits, in the order of the list.",
        examples=["[{name: table, approaches: [...]}]"],
    )  # fmt: skip
    sequence: tuple[Text, ...] = Field(
        default=(),
        description="Visits: `station`, `station approach` or `home`; all approaches in order if left out.",
    )
    cyclic: bool = Field(default=True, description="Whether the robot returns from the last visit to the first.")
    obstacles: tuple[LayoutObstacleSection, ...] = Field(default=(), description="What stands still and in the way.")
    walls: tuple[WallSection, ...] = Field(default=(), description="Walls that hold everything on one side.")
    workspace: WorkspaceSection | None = Field(default=None, description="A box that everything stays inside of.")
    cost: CostSection = Field(default=CostSection(), description="What counts beside the cycle time.")
    solver: SolverSection = Field(default=SolverSection(), description="How the layout is looked for.")

    @property
    def path(self) -> Path:
        """The file that it was read from."""
        return self._path

    def visits(self) -> list[tuple[int, int]]:
        """Return the sequence as rows of station and approach; (-1, 0) is home."""
        known = _visits_by_name(self.stations)
        if not self.sequence:
            return [
                (row, number) for row, station in enumerate(self.stations) for number in range(len(station.approaches))
            ]
        return [known[name] for name in self.sequence]

    def arm(self) -> SerialArm:
        """Return the robot without the limits that the file lays over its own.

        Raises:
            InvalidInputError: If its URDF is malformed.
        """
        entry = built_in(self.robot.model) if self.robot.urdf is None else None
        text = built_in_urdf(self.robot.model) if self.robot.urdf is None else _urdf_text(self.robot.urdf)
        named = self.robot.base_link is not None or self.robot.flange_link is not None
        return SerialArm.from_urdf(
            text,
            base_link=self.robot.base_link,
            flange_link=self.robot.flange_link,
            max_acceleration=None if entry is None or named else np.array(entry.max_acceleration),
        )


def load_layout_file(path: Path | str, overrides: Sequence[str] = ()) -> LayoutFile:
    """Read and check a layout file, with settings (``path.to.field=value``) laid over it.

    Relative paths in the file and in settings start at the file's folder.

    Raises:
        InvalidInputError: If anything in it is malformed; up to five faults are shown with line, key and mend.
    """
    document = read_document(Path(path), "layout file")
    apply_overrides(document, overrides)
    version = document.data.get("cellwright")
    if "cellwright" in document.data and (version != FORMAT or isinstance(version, bool)):
        raise refusal(
            document, [(("cellwright",), f"{version!r} is another version: this release reads cellwright: {FORMAT}")]
        )
    if "stations" not in document.data and "tasks" in document.data:
        raise InvalidInputError(
            f"{document.path} lists tasks, not stations: run cellwright sequence {document.path}, or write a file with "
            "stations"
        )
    if "stations" not in document.data and {"part", "scanner", "planner"} & document.data.keys():
        raise InvalidInputError(
            f"{document.path} describes an inspection, not a layout: run cellwright inspect {document.path}, "
            "or write a file with stations"
        )
    data: dict[str, Any] = {"name": document.path.stem, **document.data}
    try:
        file = LayoutFile.model_validate(data, context={"folder": document.path.parent})
    except ValidationError as error:
        raise refusal(document, faults_of(error, LayoutFile, document)) from error
    file._path = document.path
    faults = _disagreements(file, document)
    if faults:
        raise refusal(document, faults)
    return file


def _urdf_text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{path.name} is not a URDF: it is not text in UTF-8: save it so") from error
    except OSError as error:
        raise InvalidInputError(f"{path.name} cannot be read ({error.strerror or error}): check the file") from error


def _visits_by_name(stations: Sequence[StationSection]) -> dict[str, tuple[int, int]]:
    known: dict[str, tuple[int, int]] = {HOME: (-1, 0)}
    for row, station in enumerate(stations):
        for number, approach in reversed(list(enumerate(station.approaches))):
            if number == 0:
                known[station.name] = (row, 0)
            if approach.name is not None:
                known[f"{station.name} {approach.name}"] = (row, number)
    return known


def _disagreements(file: LayoutFile, document: Document) -> Faults:
    """Find values that are sound by themselves but do not go together."""
    faults = _name_faults(file, document) + _sequence_faults(file)
    for location, pose in _poses(file):
        if len(pose.position_m) != 3:
            faults.append(((*location, "position"), "has 2 entries but needs 3: write [x, y, z]"))
    hulls = [*file.robot.tool_hull, *(hull for station in file.stations for hull in station.hull)]
    n_spheres = sum(hull.n_spheres for hull in hulls) + sum(each.count for each in file.obstacles)
    if n_spheres > MOST_SPHERES_IN_ALL:
        faults.append(
            (("stations",), f"all hulls have {n_spheres} spheres: {MOST_SPHERES_IN_ALL} can be checked: use fewer")
        )
    moving = [file.robot.harness, *(station.harness for station in file.stations)]
    if all(harness is None for harness in moving):
        faults.append((("stations",), "nothing can be moved: give a station or the robot a harness"))
    return faults + _robot_faults(file)


def _poses(file: LayoutFile) -> list[tuple[Location, Any]]:
    return [
        (("robot", "base"), file.robot.base),
        (("robot", "tool"), file.robot.tool),
        *((("stations", row, "pose"), station.pose) for row, station in enumerate(file.stations)),
    ]


def _name_faults(file: LayoutFile, document: Document) -> Faults:
    faults: Faults = []
    seen: dict[str, Location] = {}
    named: list[tuple[Location, str]] = [
        *((("stations", row, "name"), station.name) for row, station in enumerate(file.stations)),
        *((("obstacles", row, "name"), obstacle.name) for row, obstacle in enumerate(file.obstacles)),
        *((("walls", row, "name"), wall.name) for row, wall in enumerate(file.walls)),
    ]
    for location, name in named:
        if name == HOME and location[0] == "stations":
            faults.append((location, f"{HOME!r} means the robot's home configuration: choose another name"))
        elif name in (TOOL, BASE) or name in (f"{TOOL} {number + 1}" for number in range(len(file.robot.tool_hull))):
            faults.append((location, f"{name!r} means a part of the robot: choose another name"))
        elif name in seen:
            faults.append(
                (location, f"{name!r} names something else too ({document.origin(seen[name])}): choose another")
            )
        seen.setdefault(name, location)
    for row, station in enumerate(file.stations):
        for name, what in _names_within(station):
            if name in seen:
                words = f"with {what} it reads {name!r}, which names something too ({document.origin(seen[name])})"
                faults.append((("stations", row, "name"), f"{words}: choose another"))
        names = [approach.name for approach in station.approaches if approach.name is not None]
        faults += [
            (("stations", row, "approaches", number, "name"), f"{approach.name!r} is given twice: choose another")
            for number, approach in enumerate(station.approaches)
            if approach.name is not None and names.index(approach.name) != _place(station, number)
        ]
    return faults


def _names_within(station: StationSection) -> list[tuple[str, str]]:
    """Return what approaches and hulls of a station go by in sequences and among bodies, and which of them it is."""
    hulls = range(1, len(station.hull) + 1) if len(station.hull) > 1 else ()
    return [
        *((f"{station.name} {each.name}", f"approach {each.name!r}") for each in station.approaches if each.name),
        *((f"{station.name} {number}", f"its hull {number}") for number in hulls),
    ]


def _place(station: StationSection, number: int) -> int:
    return sum(approach.name is not None for approach in station.approaches[:number])


def _sequence_faults(file: LayoutFile) -> Faults:
    known = _visits_by_name(file.stations)
    faults: Faults = [
        (("sequence", row), f"{name!r} is no station and no approach of one: {did_you_mean(name, known)}")
        for row, name in enumerate(file.sequence)
        if name not in known
    ]
    if HOME in file.sequence and file.robot.home is None:
        faults.append((("sequence",), "visits home, but robot.home is missing: add it"))
    n_visits = len(file.sequence) or sum(len(station.approaches) for station in file.stations)
    if not faults and n_visits < 2:
        where: Location = ("sequence",) if file.sequence else ("stations",)
        faults.append((where, f"the robot makes {n_visits} visits: a transition needs two, so add an approach"))
    return faults


def _robot_faults(file: LayoutFile) -> Faults:
    try:
        arm = file.arm()
    except InvalidInputError as error:
        given_links = [(key, getattr(file.robot, key)) for key in ("flange_link", "base_link")]
        named = [key for key, link in given_links if link is not None and f"has no link {link!r}" in str(error)]
        return [(("robot", named[0] if named else "model"), f"{Path(file.robot.model).name}: {error}")]
    if (wrong := _size_fault(arm)) is not None:
        return [(("robot", "model"), f"{Path(file.robot.model).name}: {wrong}")]
    given: list[tuple[Location, tuple[JointQuantity, ...] | None, str, bool]] = [
        (("robot", "home"), file.robot.home, "", False),
        (("robot", "lower"), file.robot.lower, "", True),
        (("robot", "upper"), file.robot.upper, "", True),
        (("robot", "max_velocity"), file.robot.max_velocity, "/s", True),
        (("robot", "max_acceleration"), file.robot.max_acceleration, "/s^2", True),
        (("cost", "joint_deviation"), file.cost.joint_deviation, "", True),
    ]
    faults: Faults = []
    for location, values, rate, may_be_one in given:
        if values is None:
            continue
        if len(values) != arm.n_joints and not (may_be_one and len(values) == 1):
            faults.append(
                (location, f"has {len(values)} entries but the arm has {arm.n_joints} joints: write one each")
            )
            continue
        one_for_all = len(values) < arm.n_joints
        for name, turns, (_, unit) in zip(arm.joint_names, arm.revolute, values * arm.n_joints):
            if unit != f"{'rad' if turns else 'm'}{rate}":
                kind = "turns: write an angle" if turns else "slides: write a length"
                faults.append((location, f"joint {name!r} {kind}{' for it, one value a joint' * one_for_all}"))
    if faults:
        return faults
    lower, upper = laid_over(arm.lower, file.robot.lower), laid_over(arm.upper, file.robot.upper)
    for row, name in enumerate(arm.joint_names):
        unit = "rad" if arm.revolute[row] else "m"
        if not lower[row] < upper[row]:
            faults.append(
                (
                    ("robot", "lower" if file.robot.lower is not None else "upper"),
                    f"joint {name!r} has lower limit {lower[row]:.6g} {unit} and upper limit {upper[row]:.6g} {unit}: "
                    f"move them apart by more than {lower[row] - upper[row]:.6g} {unit}",
                )
            )
        elif file.robot.home is not None and not lower[row] <= file.robot.home[row][0] <= upper[row]:
            faults.append(
                (
                    ("robot", "home"),
                    f"joint {name!r} at {file.robot.home[row][0]:.6g} {unit} is outside {lower[row]:.6g} to "
                    f"{upper[row]:.6g} {unit}: move it inside",
                )
            )
    return faults


def _size_fault(arm: SerialArm) -> str | None:
    """Say what is wrong with an arm's size or the shapes of its links; a URDF in mm is the usual slip."""
    reach = sum(float(np.linalg.norm(T[:3, 3])) for T in (*arm.T_parent_joint, arm.T_last_flange))
    if reach > LONGEST_REACH_M:
        return (
            f"the arm reaches {reach:.6g} m, but {LONGEST_REACH_M:g} m is the most that can be planned: are its "
            "lengths in mm? A URDF's are in m"
        )
    try:
        check_geometry(arm.tree)
    except InvalidInputError as error:
        return str(error)
    return None


def laid_over(own: Any, given: tuple[JointQuantity, ...] | None) -> Any:
    """Return a robot's own values (joints,), or those given in their place; one stands for all."""
    if given is None:
        return own
    return np.broadcast_to(np.array([value for value, _ in given]), own.shape).copy()
