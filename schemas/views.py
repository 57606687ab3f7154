"""Artefacts from candidate sweeps to the selected few.

A *view* is a sweep: the scanner keeps its orientation and moves along the x axis of its laser-emitter frame.
Travel is measured along that axis from the pose that looks at the view's own sample (travel 0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import BoolArray, Float32Array, FloatArray, Int8Array, Int32Array
from schemas.artefact import Artefact
from schemas.columns import ANY_WIDTH, column, fact


@dataclass(frozen=True, eq=False, repr=False)
class Viewpoints(Artefact):
    """All candidate sweeps."""

    KIND: ClassVar[str] = "viewpoints"

    sample: Int32Array = column("Surface sample that the sweep was made for", dtype="int32", table="views")
    position_m: FloatArray = column(
        "Origin of the laser-emitter frame at travel 0", width=3, unit="m", frame="part", table="views"
    )
    quaternion: FloatArray = column(
        "Orientation of the laser-emitter frame (w, x, y, z)", width=4, frame="part", table="views"
    )
    delta_rot_rad: FloatArray = column("Rotation about the viewing axis z", unit="rad", table="views")
    theta_tilt_rad: FloatArray = column("Tilt about x", unit="rad", table="views")
    psi_tilt_rad: FloatArray = column("Tilt about y", unit="rad", table="views")
    standoff_m: FloatArray = column("Distance from the sample along the viewing axis", unit="m", table="views")


@dataclass(frozen=True, eq=False, repr=False)
class Measurability(Artefact):
    """Which samples each sweep measures, at which uncertainty: the sparse measurability matrix."""

    KIND: ClassVar[str] = "measurability"

    view: Int32Array = column("View (row of the viewpoints)", dtype="int32", table="entries")
    sample: Int32Array = column("Sample that it measures", dtype="int32", table="entries")
    uncertainty_m: Float32Array = column(
        "Predicted measurement uncertainty", dtype="float32", unit="m", table="entries"
    )
    start_m: FloatArray = column(
        "First travel at which the view measures a sample; NaN if it measures none", unit="m", table="views"
    )
    end_m: FloatArray = column("Last travel at which it measures a sample", unit="m", table="views")
    cause: Int8Array = column(
        "Why no view measures the sample: the furthest test reached, `Cause`; 0 if one does",
        dtype="int8",
        table="samples",
    )


@dataclass(frozen=True, eq=False, repr=False)
class Reachability(Artefact):
    """The executable pieces of the candidate sweeps. The first piece of a view is its best one."""

    KIND: ClassVar[str] = "reachability"

    view: Int32Array = column("View (row of the viewpoints), ascending", dtype="int32", table="pieces")
    branch: Int8Array = column("Inverse kinematics branch", dtype="int8", table="pieces")
    start_m: FloatArray = column("Travel at which the piece begins", unit="m", table="pieces")
    end_m: FloatArray = column("Travel at which it ends", unit="m", table="pieces")
    q_start_rad: FloatArray = column(
        "Joint configuration at the beginning, in limits, the winding nearest to the start configuration",
        width=ANY_WIDTH,
        unit="rad",
        table="pieces",
    )
    outcome: Int8Array = column(
        "0 if the view has a piece, else `Cause`: the furthest test that any branch reached",
        dtype="int8",
        table="views",
    )
    blocked_by: Int32Array = column(
        "Body (row of `body`) that stopped the most poses of a view without a piece; -1 none",
        dtype="int32",
        table="views",
    )
    body: tuple[str, ...] = column("Names of the bodies in the cell, the part last", dtype="str", table="bodies")
    n_exact_checks: int = fact("States that the exact collision engine was asked about", dtype="int64", default=0)
    n_unsettled: int = fact(
        "Views whose best piece might be better had the limit on exact checks been higher", dtype="int64", default=0
    )


@dataclass(frozen=True, eq=False, repr=False)
class ViewSelection(Artefact):
    """The sweeps to execute, with the proof of how few there could be."""

    KIND: ClassVar[str] = "view-selection"

    view: Int32Array = column("Selected view (row of the viewpoints)", dtype="int32", table="views")
    n_samples: Int32Array = column("Samples that it measures", dtype="int32", table="views")
    n_only: Int32Array = column("Samples that it alone measures", dtype="int32", table="views")
    max_uncertainty_m: FloatArray = column(
        "Worst uncertainty of the samples that it measures best; NaN if none", unit="m", table="views"
    )
    cause: Int8Array = column(
        "Why the sample is not measured by the selection, `Cause`; 0 if it is", dtype="int8", table="samples"
    )
    greedy_view: Int32Array = column("Views that the greedy method picks", dtype="int32", table="greedy")
    method: str = fact("greedy, search, tree or integer-program: which found the selection", dtype="str")
    lower_bound: float = fact("Fewest sweeps that could do it without the excluded ones, proven (not rounded)")
    gap: float = fact("(selected - ceil(lower bound)) / selected")
    proven: bool = fact("Whether the selection is proven smallest among those without excluded sweeps", dtype="bool")
    stopped_by: str = fact("optimality, work, nodes or time: what ended the search; empty if greedy", dtype="str")
    n_excluded: int = fact(
        "Sweeps that were no candidates, as they cannot be executed or connected", dtype="int64", default=0
    )


@dataclass(frozen=True, eq=False, repr=False)
class CoverageGaps(Artefact):
    """Points of the refinement cloud that the selection misses and some candidate measures."""

    KIND: ClassVar[str] = "coverage-gaps"

    point: Int32Array = column("Row of the refinement cloud", dtype="int32", table="points")
    n_checked: int = fact("Refinement points checked", dtype="int64")
    n_missed: int = fact("Points that the selection misses, coverable or not", dtype="int64")


@dataclass(frozen=True, eq=False, repr=False)
class Coverage(Artefact):
    """What the executed scan measured on the verification cloud, which no planning stage has seen."""

    KIND: ClassVar[str] = "coverage"

    measured: BoolArray = column("Whether the scan measured the point", dtype="bool", table="points")
    coverable: BoolArray = column(
        "Whether any executable candidate sweep could measure it, connected or not", dtype="bool", table="points"
    )
    cause: Int8Array = column("Why it was not measured, `Cause`; 0 if it was", dtype="int8", table="points")
    blocked_by: Int32Array = column(
        "For collisions: body that stopped the most candidates (row of `body`); -1 none",
        dtype="int32",
        table="points",
    )
    uncertainty_m: Float32Array = column(
        "Smallest predicted uncertainty among the measurements of the point; NaN if none",
        dtype="float32",
        unit="m",
        table="points",
    )
    body: tuple[str, ...] = column("Names of the bodies in the cell", dtype="str", table="bodies")
    radius_m: float = fact("A point counts as measured with a scan point within this distance", unit="m")
    share_measured: float = fact("Measured share of all points to be measured")
    share_of_coverable: float = fact("Measured share of the points that any executable candidate can measure")
