from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cellwright.cell.bodies import WORLD, Capsule, Mesh
from cellwright.cell.built_in_robots import built_in, built_in_robot
from cellwright.cell.scene import Scene
from cellwright.errors import InvalidInputError
from schemas.artefact import digest
from schemas.cell_objects import build_cell
from schemas.poses import Pose
from schemas.sources import CellModel, SourceFile
from tasks.assemble_cell import CellModelParams, assemble_cell
from tests.cellwright.cell.robots import published_crx, shared
from tests.tasks.goldens import check_golden, rounded

HOUSING = {"shape": "box", "name": "housing", "size_m": (0.185, 0.16, 0.18), "pose": {"position_m": (0.155, 0, 0.09)}}
TABLE = {"shape": "box", "name": "table", "size_m": (2.0, 2.0, 0.1), "pose": {"position_m": (0, 0, -0.05)}}
WEDGE = SourceFile(
    name="wedge.obj", content=b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
)
FIXTURE = {
    "shape": "mesh",
    "name": "fixture",
    "file": "wedge.obj",
    "scale": (0.1, 0.1, 0.1),
    "pose": {"position_m": (0.8, 0, 0)},
}
TURNTABLE = SourceFile(
    name="turntable.urdf",
    content=b"""<robot name="turntable"><link name="base_link"/><link name="flange"><collision><origin xyz="0.5 0 0"/>
    <geometry><capsule radius="0.1" length="0.2"/></geometry></collision></link>
    <joint name="turn" type="revolute"><parent link="base_link"/><child link="flange"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="1"/></joint></robot>""",
)


def assemble(*files: SourceFile, **params: Any) -> CellModel:
    model: CellModel = assemble_cell(files, params=CellModelParams(**({"robot": "ur10e"} | params)))
    return model


def full() -> CellModel:
    return assemble(
        WEDGE,
        housing=(HOUSING,),
        bodies=(TABLE, FIXTURE),
        T_world_base=Pose(position_m=(0.0, 0.1, 0.0)),
        T_flange_scanner=Pose(position_m=(0.1665, 0.0, 0.14318)),
    )


def test_a_cell_can_be_built_again_from_its_model() -> None:
    model = full()
    cell = build_cell(model)
    assert [body.name for body in cell.bodies][-3:] == ["housing", "table", "fixture"]
    assert [body.parent for body in cell.bodies] == [0, 1, 2, 3, 4, 5, 6, 6, WORLD, WORLD]
    assert cell.T_world_base[:3, 3].tolist() == [0, 0.1, 0]
    assert cell.T_flange_scanner[:3, 3].tolist() == [0.1665, 0, 0.14318]
    assert cell.start.tolist() == list(built_in("ur10e").home)
    fixture = cell.bodies[-1].shape
    assert isinstance(fixture, Mesh)
    assert fixture.vertices.max() == pytest.approx(0.1)
    ours, theirs = cell.robot.chain, built_in_robot("ur10e").chain
    for name in ours.__dataclass_fields__:
        assert (getattr(ours, name) == getattr(theirs, name)).all()
    assert (0, 8) not in [tuple(pair) for pair in cell.ignored_pairs.tolist()]  # the base stands in the table
    assert (0, 8) not in [tuple(pair) for pair in Scene(cell).pairs.tolist()]
    assert not Scene(cell).collides(cell.start)


def test_the_part_is_the_last_body() -> None:
    shape = build_cell(full()).bodies[-1].shape
    assert isinstance(shape, Mesh)
    T = np.eye(4)
    T[:3, 3] = 0.5, 0.5, 0.0
    cell = build_cell(full(), shape, T)
    assert cell.bodies[-1].name == "part"
    assert (cell.bodies[-1].T_parent_body == T).all()


def test_the_same_recipe_gives_the_same_content() -> None:
    assert digest(full()) == digest(full())
    assert digest(full()) != digest(assemble(housing=(HOUSING,), bodies=(TABLE,)))


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(assemble_cell, rounded(full()))


def test_a_urdf_comes_from_the_files() -> None:
    model = assemble(TURNTABLE, robot="turntable.urdf", start_rad=(1.0,), max_velocity_rad_s={"turn": 2.0})
    cell = build_cell(model)
    assert cell.bodies[0].shape == Capsule(0.1, 0.2)
    assert (model.joint, model.max_velocity_rad_s.tolist()) == (("turn",), [2.0])
    assert model.max_acceleration_rad_s2 == pytest.approx(2.0 / 0.15)


def test_published_robots_are_assembled_from_their_files() -> None:
    folder = shared("robots/ur10e")
    meshes = [SourceFile(name=path.name, content=path.read_bytes()) for path in sorted(folder.glob("collision/*.stl"))]
    urdf = SourceFile(name="ur10e.urdf", content=(folder / "ur10e.urdf").read_bytes())
    start = built_in("ur10e").home
    model = assemble(urdf, *meshes, robot="ur10e.urdf", bodies=(TABLE,), start_rad=start)
    assert model.parent.tolist() == [0, 1, 2, 3, 4, 5, 6, -1]
    text, folder = published_crx()
    meshes = [SourceFile(name=path.name, content=path.read_bytes()) for path in sorted(folder.glob("collision/*.stl"))]
    crx = SourceFile(name="crx.urdf", content=text.encode())
    model = assemble(crx, *meshes, robot="crx.urdf", bodies=(TABLE,), start_rad=(0, 0.3, -0.4, 0, -1.0, 0))
    assert model.flange_link == "fanuc_flange"
    assert not Scene(build_cell(model)).collides(model.start_rad)


def test_accelerations_of_a_built_in_robot_can_be_replaced_one_by_one() -> None:
    own = built_in("ur10e").max_acceleration
    model = assemble(max_acceleration_rad_s2={"elbow_joint": 5.0})
    assert model.max_acceleration_rad_s2.tolist() == [*own[:2], 5.0, *own[3:]]
    assert assemble(max_acceleration_rad_s2=(4.0,)).max_acceleration_rad_s2.tolist() == [4.0] * 6


def test_declared_pairs_are_ignored() -> None:
    rows = [tuple(pair) for pair in assemble(bodies=(TABLE,), ignored_pairs=(("table", "wrist_3_link"),)).ignored_pair]
    assert (6, 7) in rows


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"robot": "ur10"}, "no robot named 'ur10' is built in: did you mean 'ur10e'"),
        ({"robot": "arm.urdf"}, "no robot named 'arm.urdf'"),
        ({"robot": "turntable.urdf"}, "no start configuration"),
        ({"robot": "binary.urdf", "start_rad": (0.0,)}, "not text in UTF-8"),
        ({"start_rad": (0.0,)}, "1 values, but the robot has 6 joints"),
        ({"start_rad": {"elbow_joint": 0.0}}, "name each once"),
        ({"start_rad": (0, 0, 3.2, 0, 0, 0)}, "elbow_joint 3.2 outside -3.142 to 3.142"),
        ({"start_rad": (0, 0.5, 0, 0, 0, 0), "bodies": (TABLE,)}, "start configuration collides: .*'table'"),
        ({"bodies": (TABLE, TABLE)}, "several bodies are named 'table'"),
        ({"bodies": (TABLE | {"name": "forearm_link"},)}, "several bodies are named 'forearm_link'"),
        ({"bodies": (TABLE | {"name": "part"},)}, "workpiece's name"),
        ({"bodies": (FIXTURE | {"file": "gone.stl"},)}, "mesh 'gone.stl' of body 'fixture'"),
        ({"ignored_pairs": (("table", "housing"),)}, "ignored_pairs names housing, table"),
        ({"upper_rad": {"elbow": 1.0}}, "upper names elbow"),
        ({"flange_link": "nowhere"}, "no link 'nowhere'"),
    ],
)  # fmt: skip
def test_a_cell_that_cannot_be_is_one_clear_error(params: dict[str, Any], said: str) -> None:
    binary = SourceFile(name="binary.urdf", content=b"\xff\xfe\x00")
    with pytest.raises(InvalidInputError, match=said):
        assemble(WEDGE, TURNTABLE, binary, **params)


def test_two_files_of_one_name_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"two different files are named 'wedge.obj'"):
        assemble(WEDGE, SourceFile(name="wedge.obj", content=b"other"))


@pytest.mark.parametrize("body", [TABLE | {"size_m": (1, 1, 0)}, FIXTURE | {"scale": (1, 0, 1)}, {"shape": "cone"}])
def test_bodies_without_extent_are_refused(body: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        CellModelParams(robot="ur10e", bodies=(body,))


def test_importing_the_stage_loads_no_engine() -> None:
    import subprocess
    import sys

    engines = ("pinocchio", "coal", "numba", "trimesh", "fcl")
    code = f"import tasks.assemble_cell, sys; print([m for m in {engines} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
