"""The artefact of sphere hulls: spheres that stand for the bodies of a cell, with their proofs and metrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array
from schemas.artefact import Artefact
from schemas.columns import column, fact


@dataclass(frozen=True, eq=False, repr=False)
class SphereHull(Artefact):
    """Spheres for each body: bodies in the order of the cell, the workpiece last, and spheres in theirs."""

    KIND: ClassVar[str] = "sphere-hull"

    method: str = fact("certified or k-means", dtype="str")
    body: tuple[str, ...] = column("Body names; the workpiece is called part", dtype="str", table="bodies")
    first_sphere: Int32Array = column("First sphere of the body", dtype="int32", table="bodies")
    n_spheres: Int32Array = column("Spheres of the body", dtype="int32", table="bodies")
    surface_covered: BoolArray = column(
        "Whether every point of the body's surface is proven to lie in a sphere", dtype="bool", table="bodies"
    )
    interior: tuple[str, ...] = column(
        "covered: no hole inside, proven; not covered; none: the body encloses nothing", dtype="str", table="bodies"
    )
    volume_kind: tuple[str, ...] = column(
        "What volume ratios compare with: enclosed (within the outer surface) or convex (hull of an open mesh)",
        dtype="str",
        table="bodies",
    )
    margin_m: FloatArray = column("The proofs hold for radii smaller by this", unit="m", table="bodies")
    centre_m: FloatArray = column("Sphere centres", width=3, unit="m", frame="body", table="spheres")
    radius_m: FloatArray = column("Sphere radii", unit="m", table="spheres")
    overshoot_m: FloatArray = column("How far the sphere can stick out of the body at most", unit="m", table="spheres")
    trial_body: Int32Array = column("Body of a measured hull", dtype="int32", table="trials")
    trial_n_spheres: Int32Array = column("Its number of spheres", dtype="int32", table="trials")
    trial_chosen: BoolArray = column("Whether it is the hull that is kept", dtype="bool", table="trials")
    coverage: FloatArray = column("Share of surface samples in a sphere", table="trials")
    protrusion_mean_m: FloatArray = column(
        "Mean distance of the hull's skin outside the body from it", unit="m", table="trials"
    )
    protrusion_p95_m: FloatArray = column("95th percentile of it, by area", unit="m", table="trials")
    protrusion_max_m: FloatArray = column("Largest sampled protrusion", unit="m", table="trials")
    gap_mean_m: FloatArray = column("Mean distance of surface samples from the hull, 0 in it", unit="m", table="trials")
    gap_p95_m: FloatArray = column("95th percentile of it", unit="m", table="trials")
    gap_max_m: FloatArray = column("Largest sampled gap", unit="m", table="trials")
    overshoot_max_m: FloatArray = column(
        "No point of the hull is further from the body: proven", unit="m", table="trials"
    )
    volume_m3: FloatArray = column("Volume of the union of the spheres", unit="m^3", table="trials")
    volume_ratio: FloatArray = column("Volume of the union over that of the body", table="trials")
    ignored_pair: Int32Array = column(
        "Pairs of bodies whose hulls need no check against each other, lower row first",
        dtype="int32",
        width=2,
        table="pairs",
    )
    ignored_reason: Int8Array = column(
        "0 same parent, 1 neighbours, 2 hulls always touch, 3 hulls never meet in sampling, 4 declared",
        dtype="int8",
        table="pairs",
    )
    checked_pair: Int32Array = column("The other pairs", dtype="int32", width=2, table="checked")
    touching_share: FloatArray = column("Share of sampled configurations in which the two hulls touch", table="checked")
