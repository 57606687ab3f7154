"""What does a weld cost, by stud and alternative? Run: ``python -m benchmarks.stud_welding``.

Table 1 of Bjorkenstam et al. 2014 beside the station `examples/stud_welding.yaml`: alternatives of each stud, and the
range of what holding the arm still for the two seconds of a weld costs (their weights: c_t = 1, c_e = 1e-6). The sums
are what all welds cost with the lightest alternative of each stud, a mean one, and the heaviest: between the first and
the last lies all that a sequence can save at the studs. Table 2: ``cellwright sweep studies/stud_welding.yaml``.
"""

from __future__ import annotations

import numpy as np

import tasks
from cellwright.solvers.optimal_control.cost_bounds import holding_cost
from cellwright.solvers.optimal_control.program import CostWeights
from cellwright.solvers.pose_tasks.dynamic_costs import dynamics_of
from flows.examples import find_cell_file
from flows.sequence_requests import sequence_request
from schemas.cell_objects import build_cell
from schemas.sequence_file import load_sequence_file

PUBLISHED = (
    (6, 41.16, 41.44), (8, 79.11, 80.73), (16, 110.8, 223.3), (22, 95.69, 240.0), (27, 33.78, 330.0),
    (18, 58.36, 339.6), (10, 240.8, 350.8), (16, 176.9, 448.6), (20, 89.64, 307.2), (30, 48.63, 282.2),
    (16, 35.49, 295.5), (36, 50.55, 471.6), (16, 73.29, 228.7), (13, 140.1, 447.8), (16, 44.07, 417.3),
    (9, 173.1, 324.9), (9, 181.1, 329.3), (7, 174.5, 181.5), (6, 241.5, 242.5), (6, 222.9, 223.3),
)  # fmt: skip
"""Alternatives, least and greatest cost of each stud: their table 1."""


def main() -> None:
    request = sequence_request(load_sequence_file(find_cell_file("stud_welding")))
    dynamics = request.sequence.dynamics
    if dynamics is None or dynamics.payload is None:
        raise SystemExit("the station has no planner.weights or no tool.payload")
    files = tuple(tasks.read_source(params=source) for source in request.cell_files)
    cell = tasks.assemble_cell(files, params=request.cell)
    listed = tasks.list_tasks(None, params=request.tasks)
    ways = tasks.generate_alternatives(cell, listed, params=request.alternatives)
    weights = CostWeights(dynamics.time_per_s, dynamics.effort, dynamics.velocity)
    arm = dynamics_of(build_cell(cell), dynamics.payload.payload())
    dwell = listed.dwell_s[ways.task]
    cost = weights.time * dwell + holding_cost(arm, weights, ways.position_rad, 1.0) * dwell
    own = [cost[ways.task == row] for row in range(len(listed.name))]
    print(f"{'stud':8s} {'alternatives':>12s} {'cost':>16s}   {'theirs':>6s} {'cost':>16s}")
    for name, costs, (count, least, most) in zip(listed.name, own, PUBLISHED, strict=True):
        ranges = f"{f'{costs.min():.1f} to {costs.max():.1f}':>16s}", f"{f'{least:.1f} to {most:.1f}':>16s}"
        print(f"{name:8s} {len(costs):12d} {ranges[0]}   {count:6d} {ranges[1]}")
    lightest, mean, heaviest = (sum(float(f(costs)) for costs in own) for f in (np.min, np.mean, np.max))
    print(f"ours:   lightest {lightest:.1f}, mean {mean:.1f}, heaviest {heaviest:.1f}")
    print(f"theirs: lightest {sum(p[1] for p in PUBLISHED):.1f}, heaviest {sum(p[2] for p in PUBLISHED):.1f}")


if __name__ == "__main__":
    main()
