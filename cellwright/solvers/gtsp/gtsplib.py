"""Read and write GTSPLIB files: the text format of public generalised travelling-salesman problems.

TSPLIB 95 (Reinelt) with two more keywords, ``GTSP_SETS`` and ``GTSP_SET_SECTION`` (Gutin and Karapetyan 2010). Types
GTSP and AGTSP; weights EXPLICIT in all nine matrix formats, EUC_2D, EUC_3D, CEIL_2D, MAN_2D, MAX_2D, ATT and GEO.
Type PCGLNS (Salman, Ekstedt and Damaschke 2020) is a tour from set 1 and back to it in which some sets come before
others: ``GTSP_SET_ORDERING`` lists after a set those that come later; a weight of -1 is a way that does not exist.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.problem import SequencingProblem

EARTH_KM = 6378.388
"""Radius that TSPLIB's GEO distances use."""
ORDERED, ORDERING = "PCGLNS", "GTSP_SET_ORDERING"
"""Type and section of tours in which some sets come before others."""
TSPLIB_PI = 3.141592
"""The value of pi that TSPLIB's GEO distances use."""


MOST_NUMBER = 1e15
"""Greatest coordinate or weight: sums of greater ones no longer tell whole numbers apart."""


@dataclass(frozen=True)
class _Word:
    text: str
    line: int


@dataclass
class _File:
    name: str
    fields: dict[str, _Word]
    sections: dict[str, list[_Word]]
    line_of: dict[str, int]

    def fail(self, line: int | None, text: str) -> NoReturn:
        raise InvalidInputError(f"{self.name}{'' if line is None else f', line {line}'}: {text}")

    def field(self, key: str, choices: tuple[str, ...] = ()) -> str:
        if key not in self.fields:
            self.fail(None, f"{key} is missing: add a line '{key} : ...' before the sections")
        word = self.fields[key]
        if choices and word.text not in choices:
            self.fail(word.line, f"{key} is {word.text!r}: give one of {', '.join(choices)}")
        return word.text

    def count(self, key: str) -> int:
        text = self.field(key)
        if not re.fullmatch(r"[0-9]{1,12}", text) or int(text) < 1:
            self.fail(self.fields[key].line, f"{key} is {text[:40]!r}: give a whole number of at least 1")
        return int(text)

    def section(self, key: str) -> list[_Word]:
        if key not in self.sections:
            self.fail(None, f"{key} is missing: the file may be cut off")
        return self.sections[key]

    def number(self, word: _Word, section: str) -> float:
        try:
            value = float(word.text)
        except ValueError:
            self.fail(word.line, f"{section} has {word.text!r}: give a number")
        if not abs(value) <= MOST_NUMBER:
            self.fail(word.line, f"{section} has {word.text[:40]!r}: give a number of at most {MOST_NUMBER:g}")
        return value

    def whole(self, word: _Word, section: str) -> int:
        if not re.fullmatch(r"[+-]?[0-9]{1,12}", word.text):
            self.fail(word.line, f"{section} has {word.text[:40]!r}: give a whole number")
        return int(word.text)


def read_gtsplib(path: Path | str, *, symmetric: bool | None = None) -> SequencingProblem:
    """Read a GTSPLIB file; node k of the file is alternative k - 1, set k cluster k - 1.

    Args:
        path: The file.
        symmetric: Refuse the file if its costs are not the same in both directions (true).

    Raises:
        InvalidInputError: If the file cannot be read or is malformed; the message names line, field and value.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig", errors="strict")
    except UnicodeDecodeError as error:
        raise InvalidInputError(
            f"{path} is not text in UTF-8 (byte {error.start}): save it so, or name a GTSPLIB file"
        ) from error
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read: {error.strerror}: check path and permissions") from error
    return parse_gtsplib(text, path.name, symmetric=symmetric)


def parse_gtsplib(text: str, name: str = "the text", *, symmetric: bool | None = None) -> SequencingProblem:
    """Return the problem that the text of a GTSPLIB file describes; as `read_gtsplib`."""
    file = _split(text, name)
    kind = (file.field("TYPE").split() or [""])[0]
    if kind not in ("GTSP", "AGTSP", ORDERED):
        file.fail(file.fields["TYPE"].line, f"TYPE is {kind!r}: give GTSP, AGTSP or {ORDERED}")
    if ORDERING in file.sections and kind != ORDERED:
        file.fail(file.line_of[ORDERING], f"{ORDERING} stands in a file of TYPE {kind}: write TYPE : {ORDERED}")
    n, n_sets = file.count("DIMENSION"), file.count("GTSP_SETS")
    weights = file.field("EDGE_WEIGHT_TYPE", ("EXPLICIT", *DISTANCES))
    cost = _matrix(file, n, gaps=kind == ORDERED) if weights == "EXPLICIT" else _distances(file, n, weights)
    asymmetric = np.argwhere(cost != cost.T)
    if len(asymmetric) and (kind == "GTSP" or symmetric):
        i, j = asymmetric[0]
        said = "TYPE is GTSP" if kind == "GTSP" else "a symmetric problem is asked for"
        file.fail(
            file.fields["TYPE"].line,
            f"{said}, but {i + 1} to {j + 1} costs {cost[i, j]:g} and {j + 1} to {i + 1} costs {cost[j, i]:g}: "
            + ("write TYPE : AGTSP" if kind == "GTSP" else "read it as asymmetric"),
        )
    sets, names = _sets(file, n, n_sets), tuple(f"set {k + 1}" for k in range(n_sets))
    if kind != ORDERED:
        return SequencingProblem(cost, sets, names=names)
    before = _ordering(file, n_sets) if ORDERING in file.sections else ()
    try:
        return SequencingProblem(cost, sets, start=0, before=before, names=names)
    except InvalidInputError as error:
        raise InvalidInputError(f"{name}, line {file.line_of[ORDERING]}: {error}") from error


def format_gtsplib(problem: SequencingProblem, name: str = "problem", comment: str = "") -> str:
    """Return the text of a GTSPLIB file with the costs as a matrix; `parse_gtsplib` gives the same problem back.

    The format knows closed tours only and no service costs; what must come before what and ways that do not exist only
    in tours that start in the first cluster.

    Raises:
        InvalidInputError: If the problem has what the format cannot say.
    """
    owner = problem.cluster_of()
    between = owner[:, None] != owner[None, :]
    ordered = problem.start == 0
    for unsaid, what, mend in (
        (not problem.closed, "an open sequence", "set closed"),
        (
            problem.end is not None or problem.start not in (None, 0),
            "an end, or another start than the first cluster",
            "leave both out",
        ),
        (bool(problem.before) and not ordered, "what must come before what without a start", "start in cluster 0"),
        (bool(problem.service.any()), "service costs", "add half of each to the costs into and out of it"),
        (
            bool(np.any(~np.isfinite(problem.cost) & between)) and not ordered,
            "infinite costs",
            "give a large number instead",
        ),
    ):
        if unsaid:
            raise InvalidInputError(f"a GTSPLIB file cannot hold {what}: {mend}")
    # within a cluster anything may stand, and none of it is looked at
    cost = np.where(between | (np.isfinite(problem.cost) & (problem.cost >= 0.0)), problem.cost, 0.0)
    kind = ORDERED if ordered else "GTSP" if np.array_equal(cost, cost.T) else "AGTSP"
    cost = np.where(np.isfinite(cost), cost, -1.0)
    lines = [f"NAME : {name}", f"COMMENT : {comment}" if comment else "", f"TYPE : {kind}",
             f"DIMENSION : {len(cost)}", f"GTSP_SETS : {problem.n_clusters}", "EDGE_WEIGHT_TYPE : EXPLICIT",
             "EDGE_WEIGHT_FORMAT : FULL_MATRIX", "EDGE_WEIGHT_SECTION"]  # fmt: skip
    lines += [" ".join(_plain(x) for x in row) for row in cost.tolist()]
    lines.append("GTSP_SET_SECTION")
    lines += [f"{i + 1} {' '.join(str(v + 1) for v in own)} -1" for i, own in enumerate(problem.clusters)]
    if ordered:
        lines.append(ORDERING)
        later = {i: sorted(j for i_, j in problem.before if i_ == i) for i, _ in sorted(problem.before)}
        lines += [f"{i + 1} {' '.join(str(j + 1) for j in own)} -1" for i, own in later.items()]
    return "\n".join([line for line in lines if line] + ["EOF", ""])


def _plain(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 2**53 else repr(value)


def _split(text: str, name: str) -> _File:
    """Sort the lines into fields and sections; remember where each word stood."""
    file = _File(name, {}, {}, {})
    words: list[_Word] | None = None
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if stripped == "EOF":
            break
        key = stripped.split(":")[0].strip()
        if key == ORDERING or re.fullmatch(r"[A-Z_0-9]+_SECTION", key):
            if key in file.sections:
                file.fail(number, f"{key} stands there a second time: drop one")
            words = file.sections[key] = []
            file.line_of[key] = number
        elif ":" in stripped and re.match(r"[A-Z]", stripped):
            if key in file.fields and key != "COMMENT":
                file.fail(number, f"{key} stands there a second time: drop one")
            file.fields[key] = _Word(stripped.split(":", 1)[1].strip(), number)
            words = None
        elif words is not None:
            words += [_Word(word, number) for word in stripped.split()]
        elif stripped:
            file.fail(number, f"{stripped[:40]!r} is neither a field ('KEY : value') nor in a section")
    return file


def _matrix(file: _File, n: int, *, gaps: bool) -> FloatArray:
    """Return the costs, (n, n); with ``gaps`` a weight of -1 is infinite."""
    section = "EDGE_WEIGHT_SECTION"
    shape = file.field("EDGE_WEIGHT_FORMAT", ("FULL_MATRIX", *TRIANGLES))
    words = file.section(section)
    wanted = n * n if shape == "FULL_MATRIX" else n * (n + 1) // 2 if "DIAG" in shape else n * (n - 1) // 2
    if len(words) != wanted:
        file.fail(
            words[-1].line if words else file.line_of[section],
            f"{section} has {len(words)} numbers, but {shape} of DIMENSION {n} has {wanted}: the file may be cut off, "
            "or EDGE_WEIGHT_FORMAT is another",
        )
    try:
        values = np.array([word.text for word in words], np.float64)
    except ValueError:
        values = np.array([file.number(word, section) for word in words])
    wrong = np.flatnonzero(~(values <= MOST_NUMBER) | ((values < 0) & ~(gaps & (values == -1.0))))
    if len(wrong):
        word = words[int(wrong[0])]
        file.fail(
            word.line, f"{section} has {word.text[:40]!r}: give numbers of at least 0 and at most {MOST_NUMBER:g}"
        )
    values[values < 0] = np.inf
    if shape == "FULL_MATRIX":
        return values.reshape(n, n)
    cost = np.zeros((n, n))
    offset = 0 if "DIAG" in shape else 1
    # a triangle by columns lists the same numbers as the other one by rows
    upper = TRIANGLES[shape]
    rows, columns = np.triu_indices(n, offset) if upper else np.tril_indices(n, -offset)
    cost[rows, columns] = values
    cost[columns, rows] = values
    return cost


def _distances(file: _File, n: int, kind: str) -> FloatArray:
    section = "NODE_COORD_SECTION"
    words = file.section(section)
    width = 4 if kind == "EUC_3D" else 3
    if len(words) != n * width:
        file.fail(
            words[-1].line if words else file.line_of[section],
            f"{section} has {len(words) / width:g} nodes of {width} numbers, but DIMENSION is {n}: make them agree",
        )
    points = np.full((n, width - 1), np.nan)
    for k in range(0, len(words), width):
        node = file.whole(words[k], section)
        if not 1 <= node <= n or np.isfinite(points[node - 1, 0]):
            file.fail(words[k].line, f"{section} has node {node}: number the nodes 1 to {n}, each once")
        points[node - 1] = [file.number(word, section) for word in words[k + 1 : k + width]]
    return DISTANCES[kind](points)


def _sets(file: _File, n: int, n_sets: int) -> tuple[Int32Array, ...]:
    section = "GTSP_SET_SECTION"
    sets: dict[int, list[int]] = {}
    owner: dict[int, int] = {}
    for line, number, members in _set_rows(file, section):
        if not 1 <= number <= n_sets or number in sets:
            file.fail(line, f"{section} has set {number}: number the sets 1 to {n_sets} (GTSP_SETS), each once")
        if not members:
            file.fail(line, f"set {number} has no nodes: give it at least one, or drop it and lower GTSP_SETS")
        sets[number] = []
        for word in members:
            node = file.whole(word, section)
            if not 1 <= node <= n:
                file.fail(word.line, f"set {number} has node {node}, but DIMENSION is {n}: nodes count from 1 to {n}")
            if node in owner:
                file.fail(word.line, f"node {node} is in set {owner[node]} and in set {number}: put it into one")
            owner[node] = number
            sets[number].append(node - 1)
    if len(sets) != n_sets:
        file.fail(file.line_of[section], f"{section} has {len(sets)} sets, but GTSP_SETS is {n_sets}: make them agree")
    if len(owner) != n:
        missing = next(node for node in range(1, n + 1) if node not in owner)
        file.fail(file.line_of[section], f"node {missing} is in no set ({n - len(owner)} such nodes): put it into one")
    return tuple(np.array(sets[k], np.int32) for k in range(1, n_sets + 1))


def _ordering(file: _File, n_sets: int) -> tuple[tuple[int, int], ...]:
    """Return the pairs (i, j) of clusters of which i comes before j."""
    pairs: dict[tuple[int, int], None] = {}
    for line, number, members in _set_rows(file, ORDERING):
        for each in (number, *(file.whole(word, ORDERING) for word in members)):
            if not 1 <= each <= n_sets:
                file.fail(line, f"{ORDERING} has set {each}, but GTSP_SETS is {n_sets}: sets count from 1 to {n_sets}")
            if each != number:
                pairs[number - 1, each - 1] = None
    return tuple(pairs)


def _set_rows(file: _File, section: str) -> Iterator[tuple[int, int, list[_Word]]]:
    row: list[_Word] = []
    for word in file.section(section):
        if word.text != "-1":
            row.append(word)
            continue
        if not row:
            file.fail(word.line, f"{section} has an empty set: begin each with its number")
        yield row[0].line, file.whole(row[0], section), row[1:]
        row = []
    if row:
        file.fail(row[-1].line, f"{section} ends within set {row[0].text}: close each set with -1")


def _differences(points: FloatArray) -> FloatArray:
    return points[:, None, :] - points[None, :, :]


def _rounded(values: FloatArray) -> FloatArray:
    return np.floor(values + 0.5)


def _euclidean(points: FloatArray) -> FloatArray:
    distance: FloatArray = np.sqrt((_differences(points) ** 2).sum(axis=-1))
    return distance


def _pseudo_euclidean(points: FloatArray) -> FloatArray:
    exact = np.sqrt((_differences(points) ** 2).sum(axis=-1) / 10.0)
    near = _rounded(exact)
    return np.where(near < exact, near + 1.0, near)


def _geographical(points: FloatArray) -> FloatArray:
    whole = np.trunc(points)
    latitude, longitude = (TSPLIB_PI * (whole + 5.0 * (points - whole) / 3.0) / 180.0).T
    q1 = np.cos(longitude[:, None] - longitude[None])
    q2 = np.cos(latitude[:, None] - latitude[None])
    q3 = np.cos(latitude[:, None] + latitude[None])
    angle = np.arccos(np.clip(0.5 * ((1.0 + q1) * q2 - (1.0 - q1) * q3), -1.0, 1.0))
    distance: FloatArray = np.floor(EARTH_KM * angle + 1.0)
    np.fill_diagonal(distance, 0.0)
    return distance


DISTANCES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "EUC_2D": lambda points: _rounded(_euclidean(points)),
    "EUC_3D": lambda points: _rounded(_euclidean(points)),
    "CEIL_2D": lambda points: np.ceil(_euclidean(points)),
    "MAN_2D": lambda points: _rounded(np.abs(_differences(points)).sum(axis=-1)),
    "MAX_2D": lambda points: _rounded(np.abs(_differences(points))).max(axis=-1),
    "ATT": _pseudo_euclidean,
    "GEO": _geographical,
}
"""Distances by the name of their EDGE_WEIGHT_TYPE, as TSPLIB 95 defines them."""

TRIANGLES = {
    "UPPER_ROW": True, "UPPER_DIAG_ROW": True, "LOWER_COL": True, "LOWER_DIAG_COL": True,
    "LOWER_ROW": False, "LOWER_DIAG_ROW": False, "UPPER_COL": False, "UPPER_DIAG_COL": False,
}  # fmt: skip
"""Whether the numbers of a format run as those of the upper triangle by rows; else of the lower one by rows."""
