"""Read the text form of STL strictly: what is cut off or left out must not become a part with a hole."""

from __future__ import annotations

import re

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_NAMED = re.compile(rb"^[ \t]*(?:end[ \t]*)?solid\b[^\r\n]*", re.I | re.M)
"""The lines that hold a solid's name, which may be any text."""
_LAST_END = re.compile(rb"^[ \t]*end[ \t]*solid\b[^\r\n]*\s*\Z", re.I | re.M)
_NUMBER = rb"\s+([-+.\dEeNnAaIiFf]+)"
_FACET = re.compile(
    rb"\bfacet\s+normal(?:\s+[^\s]+){0,3}?\s+outer\s+loop"
    + 3 * (rb"\s+vertex" + 3 * _NUMBER)
    + rb"\s+end\s*loop\s+end\s*facet\b",
    re.I,
)
_BEGIN = re.compile(rb"\bfacet\s+normal\b", re.I)
_VERTEX = re.compile(rb"\bvertex\b", re.I)


def is_text_stl(content: bytes) -> bool:
    """Tell whether an STL file begins as text does; some programs begin binary files with the same word."""
    content = content[:8192].removeprefix(_BYTE_ORDER_MARK)
    return content[:512].lstrip()[:5].lower() == b"solid" and b"facet" in content[:4096].lower()


def wide_text(content: bytes) -> bool:
    """Tell whether a file is an STL in UTF-16, which no program reads."""
    head = content[:64]
    return b"\0" in head[:16] and head.removeprefix(b"\xff\xfe").removeprefix(b"\xfe\xff").replace(
        b"\0", b""
    ).lstrip().lower().startswith(b"solid")


def text_stl_corners(name: str, content: bytes) -> FloatArray:
    """Return the corners of a text STL's facets, (3 facets, 3) in the file's unit.

    Raises:
        InvalidInputError: If the file is cut off, a facet has not three corners, or a number cannot be read.
    """
    content = content.removeprefix(_BYTE_ORDER_MARK)
    if b"\n" not in content:  # lines that end in a carriage return alone
        content = content.replace(b"\r", b"\n")
    if _LAST_END.search(content, max(0, len(content) - 65536)) is None:
        raise InvalidInputError(f"{name} is a text STL that is cut off: it does not end in `endsolid`: export it again")
    body = _NAMED.sub(b"", content)
    found = _FACET.findall(body)
    n_facets, n_vertices = len(_BEGIN.findall(body)), len(_VERTEX.findall(body))
    if n_vertices != 3 * n_facets:
        raise InvalidInputError(
            f"{name} is a text STL that is cut off or malformed: {n_facets} facets but {n_vertices} corners: "
            "export the part again"
        )
    if len(found) != n_facets:
        raise InvalidInputError(
            f"{name} is a text STL with a malformed vertex or facet: {n_facets - len(found)} of {n_facets} facets "
            "are not three corners in an outer loop: export the part again"
        )
    try:
        return np.array(found, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise InvalidInputError(f"{name} is a text STL with a malformed vertex: export the part again") from error
