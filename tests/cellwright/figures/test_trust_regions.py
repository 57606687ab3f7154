from __future__ import annotations

import io

import numpy as np
from PIL import Image

from cellwright.cell.scene import Scene
from cellwright.figures.trust_regions import trust_region_stages
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams, avoid
from tests.cellwright.solvers.optimal_control.planar_arm import planar_cell, planar_path, planar_program


def test_the_rounds_are_drawn_with_their_boxes_and_what_is_forbidden() -> None:
    cell = planar_cell()
    scene = Scene(cell, 0.01)
    stages = avoid(
        planar_program(), scene, MovingCorners.of(cell), planar_path(scene), AvoidanceParams(most_rounds=2)
    ).stages
    box = np.array([-1.2, -0.2]), np.array([2.0, 2.4])
    picture = np.asarray(Image.open(io.BytesIO(trust_region_stages(scene, stages, [0, 1], box))).convert("RGB"), float)
    assert picture.shape[1] > 1.5 * picture.shape[0]

    def share(colour: tuple[int, int, int]) -> float:
        return float((np.abs(picture - colour).max(axis=2) < 40).mean())

    blocked = 0.45 * np.array([0xD1, 0x49, 0x5B]) + 0.55 * 255.0
    assert 0.02 < share(tuple(blocked.tolist())) < 0.4
    assert share((0x3F, 0x6F, 0xD6)) > 0.001
    assert share((0x2A, 0x9D, 0x5C)) > 0.0005
