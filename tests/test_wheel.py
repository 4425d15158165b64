"""The wheel carries what the package needs, and installed alone in a fresh environment it runs the demo."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from shmoo_mjx.base.assets import PAPER_WEIGHTS, WEIGHTS

ROOT = Path(__file__).resolve().parents[1]
BENCH = """
from shmoo_mjx.base.assets import benchmark_suite
from shmoo_mjx.errors import ShmooError
try:
    benchmark_suite().compare_files([])
except ShmooError as error:
    print(error)
"""
DATA = ("models_xml", "experiments", "benchmarks")


@pytest.fixture(scope="module")
def uv() -> str:
    found = shutil.which("uv")
    if found is None:
        pytest.skip("the program uv, which builds the wheel, is not installed")
    return found


@pytest.fixture(scope="module")
def wheel(uv: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built as for a release: from the source distribution."""
    out = tmp_path_factory.mktemp("dist")
    done = subprocess.run([uv, "build", "--out-dir", str(out), str(ROOT)], capture_output=True, text=True, check=False)
    if done.returncode and "hatchling" in done.stderr and "fetch" in done.stderr:
        pytest.skip("no network: the build back end hatchling can't be fetched")
    assert done.returncode == 0, done.stderr
    (built,) = out.glob("*.whl")
    return built


def test_the_wheel_carries_code_models_weights_and_experiments(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        inside = {name: archive.read(name) for name in archive.namelist()}
    tracked = subprocess.run(
        ["git", "ls-files", "shmoo_mjx", *DATA], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split()
    if not tracked:
        tracked = [str(p.relative_to(ROOT)) for top in DATA for p in (ROOT / top).rglob("*") if p.is_file()]
    expected = {f if f.startswith("shmoo_mjx/") else f"shmoo_mjx/{f}": f for f in tracked if (ROOT / f).exists()}
    assert len(expected) > 10 and set(expected) <= set(inside)
    assert all(inside[name] == (ROOT / source).read_bytes() for name, source in expected.items())
    assert {f"shmoo_mjx/{WEIGHTS}", f"shmoo_mjx/{PAPER_WEIGHTS}", "shmoo_mjx/py.typed"} <= set(inside)
    # One top-level name besides the metadata; nothing of tests, data or docs.
    assert {name.partition("/")[0].partition("-")[0] for name in inside} == {"shmoo_mjx"}
    entry_points = next(text for name, text in inside.items() if name.endswith("entry_points.txt"))
    assert b"shmoo = shmoo_mjx.cli:main" in entry_points


@pytest.mark.slow
def test_installed_alone_it_runs_the_demo(wheel: Path, uv: str, tmp_path: Path) -> None:
    constraints = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["uv"]["constraint-dependencies"]
    (tmp_path / "constraints.txt").write_text("\n".join(constraints))
    venv = tmp_path / "venv"
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME")}

    def run(*command: str, cwd: Path = tmp_path) -> str:
        done = subprocess.run(command, cwd=cwd, env=kept, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    run(uv, "venv", "--python", sys.executable, str(venv), cwd=ROOT)
    pinned = ("-c", str(tmp_path / "constraints.txt"))
    run(uv, "pip", "install", "--python", str(venv / "bin/python"), *pinned, str(wheel), cwd=ROOT)
    where = run(str(venv / "bin/python"), "-c", "import shmoo_mjx; print(shmoo_mjx.__file__)")
    assert where.startswith(str(venv))
    assert "compare needs two files" in run(str(venv / "bin/python"), "-c", BENCH)
    told = run(str(venv / "bin/shmoo"), "demo", "--quick", "--seed", "0", "--out", "runs")
    assert "seed 0: success" in told
    result = json.loads((tmp_path / "runs/demo-0/result.json").read_text())
    assert result["outcome"] == "success" and (tmp_path / "runs/demo-0/report.html").stat().st_size > 10_000
