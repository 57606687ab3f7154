"""Read tool poses from a table of points: what a recorded path, or a list from another program, comes as."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.part import METRES_PER_UNIT
from cellwright.cell.transforms import pose, rotation_from_quaternion, rotation_from_rpy
from cellwright.errors import InvalidInputError

_MOST_BYTES = 4_000_000
_MOST_ROWS = 2000
_WIDTHS = (3, 7)


def read_points(path: Path, unit: str, rotation_rad: tuple[float, float, float]) -> FloatArray:
    """Return the poses (n, 4, 4) of a table with ``x, y, z`` or ``x, y, z, qw, qx, qy, qz`` in a row.

    Rows without a quaternion get ``rotation_rad`` (roll, pitch, yaw).

    Raises:
        InvalidInputError: If the file cannot be read, is too long, or a row is not of 3 or 7 finite numbers.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if not (values or rows) and words[0][0].isalpha():
            continue  # the head
        if len(values) not in _WIDTHS or not np.isfinite(values).all():
            raise InvalidInputError(
                f"{path.name}, line {number}: {line.strip()[:60]!r} is not 3 or 7 numbers: write x, y, z or "
                "x, y, z, qw, qx, qy, qz"
            )
        rows.append(values)
        if len(rows) > _MOST_ROWS:
            raise InvalidInputError(f"{path.name} has more than {_MOST_ROWS} rows: thin it out")
    if not rows:
        raise InvalidInputError(f"{path.name} has no row of numbers: write x, y, z in each")
    return np.stack([_pose(path, row, METRES_PER_UNIT[unit], rotation_rad) for row in rows])


def _text(path: Path) -> str:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read ({error.strerror or error}): check the file") from error
    if len(content) > _MOST_BYTES:
        raise InvalidInputError(f"{path.name} is {len(content) / 1e6:.0f} MB long: is it a list of points?")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{path.name} is not text (byte {error.start} is not UTF-8): write a CSV") from error


def _pose(path: Path, row: list[float], factor: float, rotation_rad: tuple[float, float, float]) -> FloatArray:
    position = factor * np.array(row[:3])
    if len(row) == 3:
        return pose(position, rotation_from_rpy(*rotation_rad))
    quaternion = np.array(row[3:])
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > 1e-3:
        raise InvalidInputError(f"{path.name} has a quaternion of length {length:.6g}: scale it to 1")
    return pose(position, rotation_from_quaternion(quaternion / length))
