"""The house's arrows: imports go down only, and the light entrances stay light."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PROJECT = Path(__file__).parents[1]

HEAVY = {
    "casadi", "open3d", "pinocchio", "coal", "fcl", "highspy", "toppra", "trimesh", "scipy", "numba", "duckdb",
    "plotly", "matplotlib", "ssik", "eaik", "cascadio", "foxglove",
}  # fmt: skip


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command; lint_imports_command()",
            "--no-cache",
        ],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
    )


def contracts() -> dict[str, Any]:
    settings: dict[str, Any] = tomllib.loads((PROJECT / "pyproject.toml").read_text())["tool"]["importlinter"]
    return settings


def layer_modules() -> Iterator[str]:
    for contract in contracts()["contracts"]:
        for layer in contract.get("layers", ()):
            yield from (name.strip() for name in layer.split("|"))


def test_imports_go_down_only() -> None:
    checked = lint(PROJECT)
    assert checked.returncode == 0, checked.stdout
    assert "0 broken" in checked.stdout


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("tasks/stage.py", "import flows"),
        ("schemas/part.py", "from storage import lake"),
        ("cellwright/cell/robot.py", "import cellwright.solvers"),
        ("storage/lake.py", "import prefect"),
        ("tasks/stage.py", "import tasks.neighbour"),
    ],
)
def test_an_import_that_goes_up_is_found(module: str, line: str, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text((PROJECT / "pyproject.toml").read_text())
    for name in {*contracts()["root_packages"], *layer_modules(), "cellwright.cell", "storage.lake", "tasks.neighbour"}:
        package = tmp_path.joinpath(*name.split("."))
        package.mkdir(parents=True, exist_ok=True)
        (package / "__init__.py").touch()
    assert lint(tmp_path).returncode == 0
    (tmp_path / module).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / module.removesuffix(".py")).mkdir(exist_ok=True)
    (tmp_path / module.removesuffix(".py") / "__init__.py").write_text(f"{line}\n")
    checked = lint(tmp_path)
    assert checked.returncode == 1
    assert "1 broken" in checked.stdout


@pytest.mark.parametrize("module", ["tasks", "flows.command_line", "storage.lake", "schemas.cell_file"])
def test_a_light_entrance_imports_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert HEAVY.isdisjoint(loaded), HEAVY & set(loaded)
