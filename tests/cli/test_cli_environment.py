"""Graphics and devices that this machine lacks, whether the user's own settings name them or not."""

import ctypes
import os
import subprocess
import sysconfig
from pathlib import Path

import pytest

from shmoo_mjx.base.environment import prepare_environment

SETTINGS = {"MUJOCO_GL": "nonsense", "JAX_PLATFORMS": "nonsense"}


def shmoo(arguments: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sysconfig.get_path("scripts")) / "shmoo"), *arguments.split()]
    return subprocess.run(
        command, cwd=folder, env=os.environ | environment, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("variable", SETTINGS)
def test_a_setting_that_names_nothing_here_gets_one_sentence(tmp_path: Path, variable: str) -> None:
    done = shmoo("demo --quick", tmp_path, **{variable: SETTINGS[variable]})
    assert done.returncode == 2, done.stderr
    assert f"{variable}=nonsense can't be used here" in done.stderr and "shmoo doctor" in done.stderr
    assert len(done.stderr.splitlines()) == 1 and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_doctor_names_those_settings_and_goes_on(tmp_path: Path) -> None:
    done = shmoo("doctor", tmp_path, **SETTINGS)
    assert done.returncode == 1, done.stderr
    assert all(f"unset {variable}" in done.stdout for variable in SETTINGS)
    assert "shipped weights: demo.safetensors" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("variable", SETTINGS)
def test_the_doctor_fails_for_one_such_setting(tmp_path: Path, variable: str) -> None:
    done = shmoo("doctor", tmp_path, **{variable: SETTINGS[variable]})
    assert done.returncode == 1, done.stderr
    assert [other for other in SETTINGS if f"unset {other}" in done.stdout] == [variable]


def test_a_server_without_egl_goes_without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file")

    for there, wanted in ((True, "egl"), (False, "disable")):
        monkeypatch.setattr(os, "environ", {})
        monkeypatch.setattr(ctypes, "CDLL", (lambda name: None) if there else missing)
        prepare_environment()
        assert os.environ["MUJOCO_GL"] == wanted


def test_without_graphics_the_doctor_says_so_and_is_content(tmp_path: Path) -> None:
    done = shmoo("doctor", tmp_path, MUJOCO_GL="disable")
    assert done.returncode == 0 and "note  3-D renderer: MUJOCO_GL is disable" in done.stdout
    assert "ok    training: flax " in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("package", ["flax", "orbax"])
def test_the_doctor_finds_what_training_lacks(tmp_path: Path, package: str) -> None:
    """As a version of the package does that is too old for JAX."""
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text("raise AttributeError('jax has no attribute of that name')")
    done = shmoo("doctor", tmp_path, PYTHONPATH=str(tmp_path))
    assert done.returncode == 1 and "Traceback" not in done.stderr + done.stdout
    assert "FAIL  training: AttributeError: jax has no attribute of that name" in done.stdout
    assert package in done.stdout.partition("FAIL  training")[2].splitlines()[1]


@pytest.mark.slow
def test_the_doctor_says_what_training_has(tmp_path: Path) -> None:
    done = shmoo("doctor", tmp_path)
    assert done.returncode == 0 and "ok    training: flax " in done.stdout
