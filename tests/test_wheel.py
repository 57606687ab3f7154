"""The wheel works on its own: installed into a new environment, it is used from a folder that is not the checkout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
COARSE = ("planner.sampling.density=0.0008 /mm^2", "planner.refinement.rounds=1")

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("wheel")]


def run(*words: str | Path, folder: Path, timeout: float = 120.0) -> str:
    """Run a command away from the checkout and return what it printed."""
    hidden = ("PYTHONPATH", "VIRTUAL_ENV", "CELLWRIGHT_LAKE")
    kept = {name: value for name, value in os.environ.items() if name not in hidden}
    environment = {**kept, "CELLWRIGHT_HOME": str(folder / "home")}
    done = subprocess.run(
        list(map(str, words)), cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of a new environment that holds our wheel, and the dependencies of this one."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)],
        cwd=PROJECT,
        check=True,
        capture_output=True,
    )
    (wheel,) = folder.glob("cellwright-*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "env", folder=folder)
    programs = folder / "env" / "bin"
    install = ["pip", "install", "--quiet", "--offline", "--no-deps", "--python", str(programs / "python")]
    run(Path(sys.executable).with_name("uv"), *install, wheel, folder=folder)
    # the dependencies of this environment; its own editable install of the checkout is not found this way
    site = Path(
        run(programs / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", folder=folder)[:-1]
    )
    dependencies = Path(sysconfig.get_path("purelib"))
    # pinocchio and coal lie in a prefix of their own, which a .pth file of that environment adds
    prefixed = dependencies / "cmeel.prefix" / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"
    (site / "dependencies.pth").write_text(f"{dependencies}\n{prefixed}\n")
    return programs


def test_everything_comes_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    names = ("cellwright", "schemas", "tasks", "storage", "flows")
    code = f"import importlib; print(*(importlib.import_module(name).__file__ for name in {names}))"
    for file in run(installed / "python", "-c", code, folder=tmp_path).split():
        assert Path(file).is_relative_to(installed.parent)
    examples = json.loads(run(installed / "cellwright", "examples", "--json", folder=tmp_path))
    assert all(Path(example["file"]).is_relative_to(installed.parent) for example in examples.values())


def test_help_answers_at_once(installed: Path, tmp_path: Path) -> None:
    seconds = []
    for _ in range(7):
        begun = time.monotonic()
        assert "cellwright inspect" in run(installed / "cellwright", "--help", folder=tmp_path)
        seconds.append(time.monotonic() - begun)
    assert min(seconds) <= 0.3, f"{min(seconds):.2f} s"


def test_the_example_is_planned_from_another_folder(installed: Path, tmp_path: Path) -> None:
    settings = [word for setting in COARSE for word in ("--set", setting)]
    words = ["inspect", "grooved_cylinder", "--direct", "--json", "--out", "results", *settings]
    result = json.loads(run(installed / "cellwright", *words, folder=tmp_path, timeout=900.0))
    assert result["summary"]["coverage"] > 0.9
    assert {path.name for path in (tmp_path / "results").iterdir()} >= {
        "report.html",
        "plan.mcap",
        "trajectory.parquet",
    }
    assert (tmp_path / "lake" / "manifests").is_dir()


def test_what_fails_is_explained_with_the_wheel_s_own_page(installed: Path, tmp_path: Path) -> None:
    setting = "planner.measurability.max_uncertainty=1e-9 um"
    words = ["inspect", "grooved_cylinder", "--direct", "--out", "results", "--set", COARSE[0], "--set", setting]
    done = subprocess.run(
        [str(installed / "cellwright"), *words],
        cwd=tmp_path,
        env={**os.environ, "CELLWRIGHT_HOME": str(tmp_path / "home")},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 3, done.stderr
    assert "No plan for" in (tmp_path / "results" / "findings.html").read_text()
