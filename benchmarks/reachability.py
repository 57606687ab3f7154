"""How long does it take to follow all sweeps? Run: ``python -m benchmarks.reachability [density per mm^2]``.

The shipped example at the paper's highest density: a UR10e with a scanner before a grooved cylinder on a pedestal,
about 20,000 sweeps. The first run pays for compilation if nothing is cached; the figures are of the second. Beside
the whole stand its bare kernels in the same run: inverse kinematics, forward kinematics of every solution, and one
bounding test of every pair of bodies at every solution. Processor seconds tell on a busy machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

import tasks
from cellwright.cell import parallel_axes
from cellwright.cell.chain_kinematics import link_poses_into
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from cellwright.cell.sphere_filter import bounding_gap, centres_into, sphere_filter
from cellwright.solvers.sweep_poses import FollowSettings, spread_poses, sweep_poses
from schemas.cell_objects import build_cell
from schemas.poses import Pose
from schemas.reach_objects import sweeps_to_follow
from schemas.sources import SourceFile
from tasks.assemble_cell import CellModelParams
from tasks.follow_sweeps import SweepParams
from tasks.measure_samples import MeasurabilityParams
from tasks.place_surroundings import SurroundingsParams
from tasks.preprocess_mesh import MeshParams
from tasks.sample_surface import SurfaceParams
from tasks.sample_viewpoints import ViewpointParams

EXAMPLE = Path(__file__).parents[1] / "examples" / "grooved_cylinder.stl"
PART_POSE = Pose(position_m=(0.68, 0.0, 0.20))


def box(name: str, size: tuple[float, float, float], position: tuple[float, float, float]) -> dict[str, Any]:
    return {"shape": "box", "name": name, "size_m": size, "pose": {"position_m": position}}


def inputs(density_per_mm2: float) -> tuple[Any, ...]:
    """Return cell, mesh, viewpoints and measurability of the example."""
    cell = tasks.assemble_cell(
        (),
        params=CellModelParams(
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
        ),
    )
    mesh = tasks.preprocess_mesh(SourceFile(name=EXAMPLE.name, content=EXAMPLE.read_bytes()), params=MeshParams())
    samples = tasks.sample_surface(mesh, params=SurfaceParams(density_per_m2=density_per_mm2 * 1e6))
    views = tasks.sample_viewpoints(samples, params=ViewpointParams())
    around = tasks.place_surroundings(cell, params=SurroundingsParams(T_world_part=PART_POSE))
    return cell, mesh, views, tasks.measure_samples(mesh, around, samples, views, params=MeasurabilityParams())


def timed(what: Callable[[], Any]) -> tuple[float, float, Any]:
    """Return wall seconds, processor seconds and result."""
    wall, processor = time.perf_counter(), time.process_time()
    result = what()
    return time.perf_counter() - wall, time.process_time() - processor, result


@numba.njit(nogil=True)
def forward(T_parent_joint: Any, axis: Any, q: Any, links: Any) -> float:
    total = 0.0
    for row in range(len(q)):
        link_poses_into(T_parent_joint, axis, q[row], links)
        total += links[-1, 0, 3]
    return total


@numba.njit(nogil=True)
def bounding(node: Any, carrier: Any, real: Any, whole: Any, pair: Any, links: Any, n: int) -> float:
    total = 0.0
    centres = np.empty((len(carrier), 3))
    for _ in range(n):
        centres_into(node, carrier, links, centres)
        for p in range(len(pair)):
            total += bounding_gap(node, real, whole, pair, p, centres)
    return total


def bare_kernels(cell: Any, mesh: Any, views: Any, seen: Any, params: SweepParams) -> float:
    """Time the bare kernels and return their processor seconds together."""
    built = build_cell(cell, mesh, params.T_world_part.matrix())
    chain = built.robot.chain
    poses = sweep_poses(built, sweeps_to_follow(views, seen, params.T_world_part.matrix()), FollowSettings())
    rows, first = np.arange(len(poses.sweep)), np.concatenate([[0], np.cumsum(poses.n_poses)])
    T = np.empty((first[-1], 4, 4))
    spread_poses(poses.T_base_flange, poses.direction, poses.step, rows, first, T)
    geometry = inverse_kinematics_for(chain).parallel_axes_geometry
    q = parallel_axes.branches(geometry, T[:100_000])
    t_inverse = timed(lambda: parallel_axes.branches(geometry, T[:100_000]))[1] / 1e5 * len(T)
    solved = np.ascontiguousarray(q.reshape(-1, 6)[np.isfinite(q.reshape(-1, 6)[:, 0])])
    n_solved = int(len(solved) / 1e5 * len(T))
    links = np.empty((7, 4, 4))
    forward(chain.T_parent_joint, chain.axis, solved[:2], links)
    t_forward = timed(lambda: forward(chain.T_parent_joint, chain.axis, solved, links))[1] / len(solved) * n_solved
    built_filter = sphere_filter(
        built, link_overshoot=0.01, tool_overshoot=0.01, field_spacing=0.008, field_padding=0.1
    )
    d = built_filter.distance
    arrays = (built_filter.node, built_filter.carrier, d.real, d.whole, built_filter.pair, links)
    bounding(*arrays, 2)
    t_bounding = timed(lambda: bounding(*arrays, 100_000))[1] / 1e5 * n_solved
    print(f"  poses {len(T)}, solutions {n_solved}, pairs of bodies {len(built_filter.pair)}")
    print(f"  bare kernels, processor: inverse kinematics {t_inverse:.2f} s, forward kinematics {t_forward:.2f} s,")
    print(f"    one bounding test a pair and solution {t_bounding:.2f} s")
    return t_inverse + t_forward + t_bounding


def main(density_per_mm2: float) -> None:
    cell, mesh, views, seen = inputs(density_per_mm2)
    params = SweepParams(T_world_part=PART_POSE)

    def follow() -> Any:
        return tasks.follow_sweeps(cell, mesh, views, seen, params=params)

    cold = timed(follow)[0]
    wall, processor, reached = timed(follow)
    n_reached = len(np.unique(reached.view))
    print(f"{len(views.sample)} sweeps: {wall:.2f} s ({processor:.2f} s processor), first run {cold:.2f} s")
    print(f"  {n_reached} can be executed, {len(reached.view)} pieces")
    print(f"  exact checks {reached.n_exact_checks}, left unsettled {reached.n_unsettled}")
    bare = bare_kernels(cell, mesh, views, seen, params)
    print(f"  ratio to the bare kernels: {processor / bare:.2f}")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 0.01)
