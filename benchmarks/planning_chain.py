"""What does planning cost beside its bare kernels? Run: ``python -m benchmarks.planning_chain [density per mm^2]``.

Sampling, measurability, reachability, trimming and set cover of the shipped example, in processor seconds of this
process, which tell on a busy machine too; after one run at a low density that pays for compilation and imports. Beside
them, from the same run, the bare kernels on exactly the items that the chain gave them (see `benchmarks.bare_kernels`).
Set cover has no such kernel: what it takes is all counted as the chain's own.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tasks
from benchmarks.bare_kernels import Tally, recording
from schemas.artefact import digest
from schemas.part import PartMesh, Surroundings
from schemas.poses import Pose
from schemas.sources import CellModel, SourceFile
from schemas.sweep_params import SweepParams
from tasks.assemble_cell import CellModelParams
from tasks.measure_samples import MeasurabilityParams
from tasks.place_surroundings import SurroundingsParams
from tasks.preprocess_mesh import MeshParams
from tasks.sample_surface import SurfaceParams
from tasks.sample_viewpoints import ViewpointParams
from tasks.select_views import SetCoverParams
from tasks.trim_measurability import TrimParams

EXAMPLE = Path(__file__).parents[1] / "examples" / "grooved_cylinder.stl"
PART_POSE = Pose(position_m=(0.68, 0.0, 0.20))
MOST_RATIO = 3.0
LOW_DENSITY = 0.0005


def box(name: str, size: tuple[float, float, float], position: tuple[float, float, float]) -> dict[str, Any]:
    """Return a box as cell models take it."""
    return {"shape": "box", "name": name, "size_m": size, "pose": {"position_m": position}}


@dataclass(frozen=True)
class Scene:
    """The example: a UR10e with a scanner before a grooved cylinder on a pedestal."""

    cell: CellModel
    mesh: PartMesh
    around: Surroundings

    @classmethod
    def example(cls) -> Scene:
        """Assemble it."""
        params = CellModelParams(
            robot="ur10e",
            T_flange_scanner=Pose(position_m=(0.1665, 0.0, 0.14318)),
            housing=(
                box("handle", (0.125, 0.052, 0.058), (0.0, 0.0, 0.083)),
                box("body", (0.185, 0.16, 0.18), (0.155, 0.0, 0.09)),
            ),
            bodies=(
                box("pedestal", (0.3, 0.3, 0.2), (0.68, 0.0, 0.1)),
                box("floor", (3.0, 3.0, 0.02), (0.0, 0.0, -0.02)),
            ),
        )
        cell = tasks.assemble_cell((), params=params)
        mesh = tasks.preprocess_mesh(SourceFile(name=EXAMPLE.name, content=EXAMPLE.read_bytes()), params=MeshParams())
        around = tasks.place_surroundings(cell, params=SurroundingsParams(T_world_part=PART_POSE))
        return cls(cell, mesh, around)


class Chain:
    """The stages from sampling to set cover, run once.

    Attributes:
        wall_s, processor_s, digest: Of each stage.
        views, seen, reached: What some of them made.
    """

    def __init__(self, scene: Scene, density_per_mm2: float) -> None:
        """Run them."""
        self.wall_s: dict[str, float] = {}
        self.processor_s: dict[str, float] = {}
        self.digest: dict[str, str] = {}
        mesh = scene.mesh
        samples = self._run(tasks.sample_surface, mesh, params=SurfaceParams(density_per_m2=density_per_mm2 * 1e6))
        self.views = self._run(tasks.sample_viewpoints, samples, params=ViewpointParams())
        self.seen = self._run(
            tasks.measure_samples, mesh, scene.around, samples, self.views, params=MeasurabilityParams()
        )
        sweeps = SweepParams(T_world_part=PART_POSE)
        self.reached = self._run(tasks.follow_sweeps, scene.cell, mesh, self.views, self.seen, params=sweeps)
        left = self._run(tasks.trim_measurability, samples, self.views, self.seen, self.reached, params=TrimParams())
        self._run(tasks.select_views, left, params=SetCoverParams())

    def _run(self, stage: Any, *artefacts: Any, params: Any) -> Any:
        wall, processor = time.perf_counter(), time.process_time()
        result = stage(*artefacts, params=params)
        self.wall_s[stage.name] = time.perf_counter() - wall
        self.processor_s[stage.name] = time.process_time() - processor
        self.digest[stage.name] = digest(result)
        return result


def tallied(scene: Scene, density_per_mm2: float) -> tuple[Tally, Chain]:
    """Run the chain with recorders; return the bare kernels' items and seconds, and what came out."""
    with recording(Tally()):  # compiles them
        Chain(scene, LOW_DENSITY)
    tally = Tally()
    with recording(tally):
        return tally, Chain(scene, density_per_mm2)


def main(density_per_mm2: float) -> int:
    """Print the chain, the kernels, the ratio; return 1 if it is above the bar."""
    scene = Scene.example()
    Chain(scene, LOW_DENSITY)
    chain = Chain(scene, density_per_mm2)
    tally, recorded = tallied(scene, density_per_mm2)
    if recorded.digest != chain.digest:
        raise SystemExit("recording changed a result: the count is of something else")
    print(f"planning chain, {len(chain.views.sample):,} candidates, processor seconds (wall seconds)")
    for name, seconds in chain.processor_s.items():
        print(f"  {name:45s} {seconds:8.2f} s ({chain.wall_s[name]:.2f} s)")
    whole = sum(chain.processor_s.values())
    print(f"  {'together':45s} {whole:8.2f} s ({sum(chain.wall_s.values()):.2f} s)")
    print("bare kernels on the same items, one thread")
    tally.show()
    ratio = whole / tally.total_s
    print(f"chain over bare kernels                         {ratio:8.2f}   (bar {MOST_RATIO:g})")
    return int(ratio > MOST_RATIO)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 0.01))
