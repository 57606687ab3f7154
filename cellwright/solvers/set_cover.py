"""Pick few columns of a zero-one matrix that together cover its rows: the set-covering problem.

`cover_greedily` is the method of Kaiser 2021, section 4.3 (Chvatal 1979): at most ``1 + ln d`` times the optimum, d the
most rows that one column covers. `cover_best` is the default: reductions, Lagrangian and linear-programming bounds,
a local search, and a branch and bound that proves the result or leaves an honest gap within a fixed amount of work; it
reads no clock, so its result is the same on every machine. `cover_exactly` hands the reduced problem to HiGHS.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numba
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.errors import InfeasibleError, InvalidInputError, listed
from cellwright.solvers.set_cover_bounds import LowerBound, lower_bound
from cellwright.solvers.set_cover_exact import cover_exactly
from cellwright.solvers.set_cover_matrix import TOLERANCE, Cover, CoverMatrix, cover_matrix
from cellwright.solvers.set_cover_reductions import ReducedCover, reduce_cover
from cellwright.solvers.set_cover_relaxation import Relaxation, solve_relaxation
from cellwright.solvers.set_cover_search import improve_cover
from cellwright.solvers.set_cover_tree import search_tree

__all__ = [
    "Cover",
    "CoverMatrix",
    "LowerBound",
    "ReducedCover",
    "cover_best",
    "cover_exactly",
    "cover_greedily",
    "cover_matrix",
    "lower_bound",
    "reduce_cover",
]
