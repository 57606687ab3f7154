"""Read one dataset of numbers from a plain HDF5 file, without a library for all that the format can hold.

Files of the classic layout (superblock 0 or 1, as libraries write by default): datasets of groups, stored in one
piece, not compressed, of little-endian numbers. Anything else is refused with the advice to save it as CSV. After the
HDF5 File Format Specification, version 3.0, sections II.A, III.A-D and IV.A.
"""

from __future__ import annotations

import struct
from typing import NoReturn

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MOST_BYTES = 100_000_000
_DATASPACE, _DATATYPE, _LAYOUT, _FILTERS, _CONTINUED, _GROUP = 1, 3, 8, 11, 16, 17
_FIXED, _FLOAT = 0, 1
_CONTIGUOUS = 1
_MOST_MESSAGES, _MOST_LEVELS = 10_000, 32


def read_dataset(name: str, content: bytes, dataset: str) -> FloatArray:
    """Return a dataset, ``name`` or ``group/name``, as doubles.

    Raises:
        InvalidInputError: If the file is no HDF5 file, has no such dataset, or stores it in a way that is not read.
    """
    return _File(name, content).dataset(dataset)


class _File:
    def __init__(self, name: str, content: bytes) -> None:
        self.name, self.content = name, content
        if not content.startswith(_SIGNATURE):
            self.refuse("is no HDF5 file")
        if self.at("B", 8)[0] > 1 or self.at("BB", 13) != (8, 8):
            self.refuse("has an HDF5 layout newer than the classic one")

    def refuse(self, what: str) -> NoReturn:
        raise InvalidInputError(f"{self.name} {what}: save its targets as CSV (x,y,z,dx,dy,dz)")

    def at(self, form: str, offset: int) -> tuple[int, ...]:
        """Return little-endian whole numbers at an offset."""
        try:
            found: tuple[int, ...] = struct.unpack_from(f"<{form}", self.content, offset)
        except (struct.error, OverflowError):
            self.refuse(f"is cut off or damaged near byte {offset}")
        return found

    def dataset(self, wanted: str) -> FloatArray:
        first = 24 if self.at("B", 8)[0] == 0 else 28  # behind sizes and flags; then four addresses, then the root
        kind, tree, heap = self.at("I4xQQ", first + 32 + 16)
        if kind != 1:
            self.refuse("does not say where its root group lies")
        *groups, last = wanted.split("/")
        for group in groups:
            messages = self._messages(self._member(tree, heap, group, wanted))
            if _GROUP not in messages:
                self.refuse(f"has no dataset {wanted!r}")
            tree, heap = self.at("QQ", messages[_GROUP])
        return self._values(wanted, self._messages(self._member(tree, heap, last, wanted)))

    def _member(self, tree: int, heap: int, name: str, wanted: str) -> int:
        (names,) = self.at("Q", heap + 24)
        address = self._found(tree, names, name.encode(), 0)
        if address is None:
            self.refuse(f"has no dataset {wanted!r}")
        return address

    def _found(self, node: int, names: int, wanted: bytes, depth: int) -> int | None:
        """Return the address of the entry with a name, in a tree of symbol tables."""
        if depth > _MOST_LEVELS:
            self.refuse("has a damaged index")
        signature = self.content[node : node + 4]
        if signature == b"SNOD":
            (count,) = self.at("H", node + 6)
            for row in range(count):
                text, address = self.at("QQ", node + 8 + 40 * row)
                if self.content[names + text :].split(b"\0", 1)[0] == wanted:
                    return address
            return None
        if signature != b"TREE":
            self.refuse("has a damaged index")
        (count,) = self.at("H", node + 6)
        for row in range(count):
            (child,) = self.at("Q", node + 24 + 8 + 16 * row)
            found = self._found(child, names, wanted, depth + 1)
            if found is not None:
                return found
        return None

    def _messages(self, address: int) -> dict[int, int]:
        """Return where the body of each message of an object lies, by its type."""
        version, count, size = self.at("BxHxxxxI", address)
        if version != 1:
            self.refuse("has an HDF5 layout newer than the classic one")
        found: dict[int, int] = {}
        blocks, n_read = [(address + 16, size)], 0
        while blocks and n_read < min(count, _MOST_MESSAGES):
            place, left = blocks.pop(0)
            while left >= 8 and n_read < count:
                kind, length = self.at("HH", place)
                n_read += 1
                if kind == _CONTINUED:
                    further, room = self.at("QQ", place + 8)
                    blocks.append((further, room))
                found.setdefault(kind, place + 8)
                place, left = place + 8 + length, left - 8 - length
        return found

    def _values(self, dataset: str, messages: dict[int, int]) -> FloatArray:
        if _FILTERS in messages or not {_DATASPACE, _DATATYPE, _LAYOUT} <= messages.keys():
            self.refuse(f"stores {dataset!r} compressed or not at all")
        space = messages[_DATASPACE]
        version, rank = self.at("BB", space)
        shape = self.at(f"{rank}Q", space + (8 if version == 1 else 4))
        kind, order, size = self.at("BBxxI", messages[_DATATYPE])
        code = {_FIXED: "i" if order & 8 else "u", _FLOAT: "f"}.get(kind & 15)
        if code is None or order & 1 or size not in (4, 8):
            self.refuse(f"stores {dataset!r} as something else than little-endian numbers")
        layout, how = self.at("BB", messages[_LAYOUT])
        if layout != 3 or how != _CONTIGUOUS:
            self.refuse(f"stores {dataset!r} in pieces")
        place, n_bytes = self.at("QQ", messages[_LAYOUT] + 2)
        if n_bytes > _MOST_BYTES or n_bytes != size * int(np.prod(shape, dtype=object)):
            self.refuse(f"says that {dataset!r} of shape {shape} takes {n_bytes} bytes")
        if place + n_bytes > len(self.content):
            self.refuse("is cut off")
        raw = np.frombuffer(self.content, f"<{code}{size}", n_bytes // size, place)
        return raw.astype(np.float64).reshape(shape)
