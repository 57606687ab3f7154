"""Published parts and made-up ones through the whole inspection: each ends in a verified plan or in one finding.

The default run plans three of them with few samples; the others, at the density that users get, are slow.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cellwright.causes import Cause
from cellwright.errors import InfeasibleError, InvalidInputError
from flows import inspection
from flows.execution import open_lake
from flows.findings import Findings
from tests.cellwright.cell.robots import published_crx, shared

CELLS = Path(__file__).parent / "cells"
COARSE = "planner.sampling.density=0.001 /mm^2"
CELL = """
cellwright: 1
robot: {model: ur10e, start: [0 deg, -110 deg, 80 deg, -60 deg, -90 deg, 0 deg]}
part: {file: part.stl, unit: UNIT, rests_on: pedestal, pose: {position: [680 mm, 0 mm]}}
table:
  name: pedestal
  box: {size: [300 mm, 300 mm, 200 mm]}
  pose: {position: [680 mm, 0 mm, 100 mm]}
obstacles:
  - name: floor
    box: {size: [3 m, 3 m, 20 mm]}
    pose: {position: [0 mm, 0 mm, -20 mm]}
"""


@pytest.fixture(scope="session")
def lake_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """One lake for all: most parts stand in the same cell."""
    return str(tmp_path_factory.mktemp("lake"))


def planned(cell: Path, lake_url: str, *overrides: str) -> dict[str, Any]:
    """Plan a cell and check what every plan must hold; returns its figures."""
    result = inspection.run(cell, overrides=overrides, lake=lake_url, direct=True)
    lake = open_lake(lake_url)
    verification: Any = lake.load(result.refs["verification"])
    assert "colliding states" in verification.check
    short = np.where(verification.at_least, verification.permitted - verification.found, 0.0)
    beyond = np.where(verification.at_least, 0.0, verification.found - verification.permitted)
    assert (short <= 0.0).all() and (beyond <= 0.0).all()
    assert verification.n_states > 1000
    coverage: Any = lake.load(result.refs["coverage"])
    figures = result.summary
    assert sum(figures["causes"].values()) == (~coverage.measured).sum()
    assert not coverage.cause[coverage.measured].any()
    stands_in_the_way = coverage.cause == Cause.COLLISION
    assert (coverage.blocked_by[stands_in_the_way] >= 0).all()
    assert np.ceil(figures["sweeps_lower_bound"] - 1e-6) <= figures["sweeps"] <= figures["greedy_sweeps"]
    return figures


def published(name: str, part: str) -> Path:
    shared(f"parts/{part}")
    return CELLS / f"{name}.yaml"


def made(folder: Path, part: trimesh.Trimesh, unit: str = "mm") -> Path:
    """Write a part in mm, or in another unit, and the cell that it stands in."""
    part.export(folder / "part.stl")
    cell = folder / "cell.yaml"
    cell.write_text(CELL.replace("UNIT", unit))
    return cell


@pytest.mark.parametrize(
    ("name", "part", "least"),
    [
        ("nist_11", "NIST_MBE_PMI_11.stp", 0.97),
        ("fandisk", "fandisk.obj", 0.93),
        ("featuretype", "featuretype.STL", 0.80),
    ],
)
def test_a_part_with_few_samples_ends_in_a_verified_plan(name: str, part: str, least: float, lake_url: str) -> None:
    figures = planned(published(name, part), lake_url, COARSE)
    assert figures["coverage"] >= least
    assert figures["coverage_of_coverable"] >= 0.95


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "part", "least"),
    [
        ("nist_1", "NIST_MBE_PMI_1.stp", 0.92),
        ("nist_3", "NIST_MBE_PMI_3.stp", 0.89),
        ("nist_5", "NIST_MBE_PMI_5.stp", 0.84),
        ("nist_11", "NIST_MBE_PMI_11.stp", 0.99),
        ("featuretype", "featuretype.STL", 0.86),
        ("fandisk", "fandisk.obj", 0.98),
        ("angle_block", "angle_block.STL", 0.94),
        ("wavy_mesh_with_hole", "wavy_mesh_with_hole.ply", 0.99),
    ],
)
def test_published_parts_end_in_verified_plans(name: str, part: str, least: float, lake_url: str) -> None:
    figures = planned(published(name, part), lake_url)
    assert figures["coverage"] >= least
    assert figures["coverage_of_coverable"] >= 0.99


@pytest.mark.slow
def test_the_ur10e_with_its_published_meshes_measures_what_the_built_in_one_does(lake_url: str) -> None:
    shared("robots/ur10e")
    with_meshes = planned(published("ur10e_meshes", "featuretype.STL"), lake_url)
    built_in = planned(published("featuretype", "featuretype.STL"), lake_url)
    assert with_meshes["coverage"] == pytest.approx(built_in["coverage"], abs=0.01)
    assert with_meshes["sweeps"] == pytest.approx(built_in["sweeps"], abs=2)


@pytest.mark.slow
def test_a_crx_with_its_published_meshes_plans(tmp_path: Path, lake_url: str) -> None:
    cell = published("crx10ia_l", "featuretype.STL")
    text, folder = published_crx()
    (tmp_path / "crx10ia_l.urdf").write_text(text)
    (tmp_path / "collision").symlink_to(folder / "collision")
    figures = planned(cell, lake_url, f"robot.model={tmp_path / 'crx10ia_l.urdf'}")
    assert figures["coverage"] >= 0.86


def test_a_part_beyond_the_arm_is_a_finding(tmp_path: Path, lake_url: str) -> None:
    cell = made(tmp_path, trimesh.creation.box((150, 100, 60)))
    far = ("part.rests_on=null", "part.pose.position=[2.5 m, 0 mm, 230 mm]")
    with pytest.raises(InfeasibleError, match=r"none of \d+ views measures any of (\d+) samples \(\1 out of reach\)"):
        inspection.run(cell, overrides=(*far, COARSE), lake=lake_url, direct=True)


def test_a_part_inside_the_robots_foot_is_a_finding(tmp_path: Path, lake_url: str) -> None:
    cell = made(tmp_path, trimesh.creation.box((150, 100, 60)))
    inside = ("part.rests_on=null", "part.pose.position=[0 mm, 0 mm, 100 mm]")
    found: list[Findings] = []
    with pytest.raises(InvalidInputError, match="the start configuration brings shoulder_link and part closer"):
        inspection.run(cell, overrides=(*inside, COARSE), lake=lake_url, direct=True, explain=found.append)
    said = found[0].as_json()["overlaps"]
    assert any(words.startswith("part and base_link_inertia stand in one another, by at least ") for words in said)
    assert said[0] in found[0].as_markdown()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "unit", "least"),
    [
        (trimesh.creation.box((200, 120, 2)), "mm", 0.99),
        (trimesh.creation.torus(60, 18), "mm", 0.80),
        (trimesh.creation.box((8, 8, 8)), "mm", 0.99),
        (trimesh.creation.box((6, 4, 3)), "in", 0.99),
        (trimesh.creation.revolve([(0, 0), (50, 0), (50, 80), (20, 80), (20, 10), (0, 10)], sections=64), "mm", 0.90),
        (
            trimesh.util.concatenate(
                [trimesh.creation.box(bounds=[(x, -30, 0), (x + 60, 30, 40)]) for x in (-120, -30, 60)]
            ),
            "mm",
            0.98,
        ),
    ],
    ids=["thin plate", "torus", "tiny cube", "inches", "deep bore", "three bodies"],
)
def test_made_up_parts_end_in_verified_plans(
    part: trimesh.Trimesh, unit: str, least: float, tmp_path: Path, lake_url: str
) -> None:
    figures = planned(made(tmp_path, part, unit), lake_url)
    assert figures["coverage"] >= least
    assert figures["coverage_of_coverable"] >= 0.99
