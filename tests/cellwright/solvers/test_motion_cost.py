from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.built_in_robots import built_in_bodies, built_in_robot
from cellwright.cell.scene import Scene
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import symbolic_dynamics
from cellwright.cell.verification_scene import VerificationScene
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.connections import Connections, ConnectionSteps
from cellwright.solvers.gtsp.lazy import solve_lazily
from cellwright.solvers.gtsp.problem import SequencingProblem
from cellwright.solvers.hermite import states_at
from cellwright.solvers.motion_cost import MotionCost, PathCost, PlannedMotions, VelocityCost
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams, collision_on
from cellwright.solvers.optimal_control.motion import Obstacles, OptimalControlCost
from cellwright.solvers.optimal_control.program import MotionProgram
from cellwright.solvers.path_timing import Limits
from cellwright.solvers.roadmap import Roadmap, RoadmapSize
from tests.cellwright.cell.cells import at, cell_of
from tests.cellwright.solvers.motion_cost_contract import assert_keeps_its_promises
from tests.cellwright.solvers.optimal_control.planar_arm import GOAL, START, planar_cell, planar_program

CELL = planar_cell()
CHAIN = CELL.robot.chain
CORNERS = MovingCorners.of(CELL)
LIMITS = Limits(CHAIN.max_velocity, CHAIN.max_acceleration)
PLACES = np.array([START, [-0.3, 1.8], GOAL, [0.1, 2.3]])


def connections(scene: Scene) -> Connections:
    rng = np.random.default_rng(0)
    size = RoadmapSize(n_nodes=150, n_batch=100, n_most=600, n_neighbours=8)
    roadmap = Roadmap(scene, CHAIN.lower, CHAIN.upper, CHAIN.max_velocity, size=size, rng=rng)
    return Connections(scene, roadmap, CORNERS, LIMITS, ConnectionSteps(0.02, 0.02, 0.005, 0.05), rng)


def costs() -> list[MotionCost]:
    scene = Scene(CELL, 0.01)
    obstacles = Obstacles(scene, CORNERS, PathCost(connections(scene), LIMITS), AvoidanceParams())
    program = planar_program()
    return [
        VelocityCost(CHAIN.max_velocity),
        PathCost(connections(scene), LIMITS),
        OptimalControlCost(program),
        OptimalControlCost(program, obstacles),
    ]


@pytest.mark.parametrize("number", range(4))
def test_every_cost_keeps_its_promises(number: int) -> None:
    assert_keeps_its_promises(costs()[number], PLACES, CHAIN.max_velocity)


def test_motions_among_posts_are_free_and_dearer_than_without_them() -> None:
    scene = Scene(CELL, 0.01)
    _, path, free, cost = costs()
    among, alone, timed = cost.motion(START, GOAL), free.motion(START, GOAL), path.motion(START, GOAL)
    assert among is not None and alone is not None and timed is not None
    assert collision_on(scene, CORNERS, alone.motion, AvoidanceParams()) is not None
    assert collision_on(scene, CORNERS, among.motion, AvoidanceParams()) is None
    assert alone.cost < among.cost
    assert isinstance(cost, OptimalControlCost)
    # the path that it began with, under the same cost
    assert among.cost < cost.of_motion(timed.motion).cost


def test_ends_that_collide_are_named_with_their_distance() -> None:
    cost = costs()[3]
    with pytest.raises(InfeasibleError, match=r"'fore' and 'post' are 0 mm apart at the goal, but the clearance is 10"):
        cost.motion(START, np.array([0.3, 0.0]))


def test_lazy_sequencing_finds_what_full_evaluation_finds() -> None:
    cost = OptimalControlCost(planar_program(), warm=False)
    rng = np.random.default_rng(2)
    q = rng.uniform(-2.0, 2.0, (10, 2))
    clusters = tuple((2 * k, 2 * k + 1) for k in range(5))
    planned = PlannedMotions(cost, q, dwell=0.5)
    problem = SequencingProblem(planned.bounds, clusters=clusters, service=planned.service)
    lazy = solve_lazily(problem, planned.evaluate, np.random.default_rng(0), symmetric=True)
    full = np.zeros((10, 10))
    for a, b in itertools.combinations(range(10), 2):
        full[a, b] = full[b, a] = PlannedMotions(cost, q).evaluate(a, b)
    best = min(
        sum(full[tour[k], tour[(k + 1) % 5]] + planned.service[tour[k]] for k in range(5))
        for order in itertools.permutations(range(1, 5))
        for tour in itertools.product(*(clusters[k] for k in (0, *order)))
    )
    assert lazy.result.cost == pytest.approx(best, rel=1e-6)
    assert lazy.result.proven
    nodes = lazy.result.nodes.tolist()
    for a, b in zip(nodes, nodes[1:] + nodes[:1]):
        assert planned.found.get((a, b)) or planned.found.get((b, a))


def test_a_motion_is_asked_for_once() -> None:
    class Counting(VelocityCost):
        asked = 0

        def motion(self, q_a, q_b):  # type: ignore[no-untyped-def]
            Counting.asked += 1
            return super().motion(q_a, q_b)

    planned = PlannedMotions(Counting(np.ones(2)), PLACES)
    assert planned.evaluate(0, 1) == planned.evaluate(0, 1)
    assert Counting.asked == 1
    with pytest.raises(InvalidInputError, match="q has shape"):
        PlannedMotions(Counting(np.ones(2)), np.zeros(3))


def test_a_six_axis_arm_goes_round_a_wall_cheaper_than_the_path_it_began_with() -> None:
    robot, stand, ground = built_in_robot("ur10e"), at(0.7, 0.0, 0.4), at(0.0, 0.0, -0.06)
    wall = Body("wall", Box((0.6, 0.05, 0.8)), WORLD, stand)
    floor = Body("floor", Box((2.0, 2.0, 0.1)), WORLD, ground)
    cell = cell_of(robot, (*built_in_bodies("ur10e", robot), wall, floor))
    scene, corners, chain, rng = Scene(cell, 0.01), MovingCorners.of(cell), robot.chain, np.random.default_rng(0)
    limits = Limits(chain.max_velocity, chain.max_acceleration)
    reach = np.full(6, 3.2)
    roadmap = Roadmap(scene, -reach, reach, chain.max_velocity, size=RoadmapSize(n_nodes=300), rng=rng)
    paths = PathCost(Connections(scene, roadmap, corners, limits, ConnectionSteps(0.03, 0.03, 0.01, 0.05), rng), limits)
    program = MotionProgram(symbolic_dynamics(SerialArm.from_robot(robot)))
    params = AvoidanceParams(most_rounds=4)
    cost = OptimalControlCost(program, Obstacles(scene, corners, paths, params))
    q_a, q_b = (np.array([pan, -0.9, 1.4, -2.0, -1.57, 0.0]) for pan in (-0.9, 1.0))
    straight = OptimalControlCost(program).motion(q_a, q_b)
    found, path = cost.motion(q_a, q_b), paths.motion(q_a, q_b)
    assert straight is not None and found is not None and path is not None
    assert path.via == "roadmap" and found.via == "optimal control"
    assert collision_on(scene, corners, straight.motion, params) is not None
    assert collision_on(scene, corners, found.motion, params) is None
    assert cost.bound(q_a, q_b) < straight.cost < found.cost < cost.of_motion(path.motion).cost
    # by another engine, on other states
    other = VerificationScene(cell)
    states, _ = states_at(
        found.motion.time, found.motion.position, found.motion.velocity, np.linspace(0.0, found.motion.duration, 301)
    )
    assert min(other.distance(q) for q in states) > 0.009
