"""Between the artefact `CellModel` and the library's `Cell`: pack bodies into columns, and build the cell again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.cell.bodies import Body, Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.cell import PART, Cell
from cellwright.cell.ignored_pairs import Reason
from cellwright.cell.robot import Robot
from cellwright.errors import InvalidInputError
from schemas.part import PartMesh
from schemas.sources import CellModel

KINDS: dict[type[Any], str] = {Box: "box", Cylinder: "cylinder", Sphere: "sphere", Capsule: "capsule", Mesh: "mesh"}


def build_cell(
    model: CellModel, part_mesh: PartMesh | Mesh | None = None, T_world_part: FloatArray | None = None
) -> Cell:
    """Return the cell that a model describes, with the workpiece as its last body if one is given.

    ``T_world_part`` (4, 4) is the identity if left out.

    Raises:
        InvalidInputError: If the model contradicts itself, as no model of `assemble_cell` does.
    """
    cell = Cell(
        robot=Robot.from_urdf(
            model.urdf,
            base_link=model.base_link,
            flange_link=model.flange_link,
            lower=model.lower_rad,
            upper=model.upper_rad,
            max_velocity=model.max_velocity_rad_s,
            max_acceleration=model.max_acceleration_rad_s2,
        ),
        bodies=unpacked_bodies(model),
        ignored_pairs=model.ignored_pair,
        T_world_base=model.T_world_base.copy(),
        T_flange_scanner=model.T_flange_scanner.copy(),
        start=model.start_rad.copy(),
        never_touching=model.ignored_pair[model.ignored_reason == Reason.NEVER_TOUCHING],
    )
    if part_mesh is None:
        return cell
    if PART in model.body:
        raise InvalidInputError(f"a body of the cell is named {PART!r}: that is the workpiece's name")
    mesh = part_mesh if isinstance(part_mesh, Mesh) else Mesh(part_mesh.vertices_m, part_mesh.faces)
    return cell.with_part(mesh, np.eye(4) if T_world_part is None else np.asarray(T_world_part, float))


def known_torques(cell: Cell, torque_nm: FloatArray) -> dict[str, Any]:
    """Return what `plan_chart` takes of torques (states, joints) and their limits, nothing where they are left out."""
    from cellwright.cell.serial_arm import SerialArm

    return {"torque": torque_nm, "max_torque": SerialArm.from_robot(cell.robot).max_effort} if torque_nm.size else {}


def packed_bodies(bodies: Sequence[Body]) -> dict[str, Any]:
    """Return the columns of a `CellModel` that hold its bodies."""
    vertices: list[FloatArray] = []
    faces: list[Int32Array] = []
    counts = np.zeros((len(bodies), 2), np.int32)
    for row, body in enumerate(bodies):
        if isinstance(body.shape, Mesh):
            vertices.append(body.shape.vertices)
            faces.append(body.shape.faces)
            counts[row] = len(body.shape.vertices), len(body.shape.faces)
    first = (np.cumsum(counts, axis=0) - counts).astype(np.int32)
    return {
        "body": tuple(body.name for body in bodies),
        "parent": np.array([body.parent for body in bodies], np.int32),
        "shape": tuple(KINDS[type(body.shape)] for body in bodies),
        "size_m": np.array([_size(body.shape) for body in bodies], float).reshape(-1, 3),
        "T_parent_body": np.array([body.T_parent_body.ravel() for body in bodies], float).reshape(-1, 16),
        "first_vertex": first[:, 0],
        "n_vertices": counts[:, 0],
        "first_face": first[:, 1],
        "n_faces": counts[:, 1],
        "vertices_m": np.concatenate([np.empty((0, 3)), *vertices]),
        "faces": np.concatenate([np.empty((0, 3), np.int32), *faces]),
    }


def unpacked_bodies(model: CellModel) -> tuple[Body, ...]:
    """Return the bodies that a model's columns hold.

    Raises:
        InvalidInputError: If a shape has an unknown name.
    """
    bodies: list[Body] = []
    for row, name in enumerate(model.body):
        a, b, c = model.size_m[row].tolist()
        match model.shape[row]:
            case "box":
                shape: Shape = Box((a, b, c))
            case "cylinder":
                shape = Cylinder(a, b)
            case "sphere":
                shape = Sphere(a)
            case "capsule":
                shape = Capsule(a, b)
            case "mesh":
                shape = Mesh(
                    _rows(model.vertices_m, model.first_vertex[row], model.n_vertices[row]),
                    _rows(model.faces, model.first_face[row], model.n_faces[row]),
                )
            case other:
                raise InvalidInputError(f"body {name!r} of the cell model has shape {other!r}: assemble the cell again")
        bodies.append(Body(name, shape, int(model.parent[row]), model.T_parent_body[row].reshape(4, 4).copy()))
    return tuple(bodies)


def _rows(table: Any, first: int, count: int) -> Any:
    return table[first : first + count].copy()


def _size(shape: Shape) -> tuple[float, float, float]:
    match shape:
        case Box(size):
            return size
        case Cylinder(radius, length) | Capsule(radius, length):
            return (radius, length, 0.0)
        case Sphere(radius):
            return (radius, 0.0, 0.0)
        case Mesh():
            return (0.0, 0.0, 0.0)
