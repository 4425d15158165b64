"""What every test shares: a compilation cache that lasts between runs, and where other people's data lie."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from hypothesis import settings

from shmoo_mjx.base.environment import headless_graphics

ROOT = Path(__file__).resolve().parent.parent
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# A red CI must be red again on the next try; at the desk each run draws new examples.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")
# Containers often forbid writing bytecode. Every process of the tests would then compile all that it imports, 5 s each.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
if not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", headless_graphics())


LONGEST = (
    "test_killed",
    "test_gym_batch",
    "test_comparison_experiments",
    "test_navigator",
    "test_navigator_steps",
    "test_sensed_engine",
    "test_rollout_layout",
    "test_code_blocks",
    "test_adaptation",
    "test_cli",
)
"""Files that take longest: they go first, so that no worker is left alone with one at the end."""


def pytest_configure(config: pytest.Config) -> None:
    """Quick tests compile without optimisation, which halves the time of a first run; slow ones compile as users do."""
    flags = os.environ.get("XLA_FLAGS", "")
    if config.getoption("markexpr") == "not slow" and "xla_backend_optimization_level" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_optimization_level=0".strip()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """Single files run in this process, where prints and debuggers work; more than that on every core."""
    return 0 if all(Path(name.partition("::")[0]).suffix == ".py" for name in config.args) else None


@pytest.fixture
def shmoo(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., CompletedProcess[str]]:
    """The command line in this process, which has paid for its imports already."""
    from shmoo_mjx.cli import main

    def run(*words: str) -> CompletedProcess[str]:
        monkeypatch.setattr(sys, "argv", ["shmoo", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return CompletedProcess(words, int(ended.value.code or 0), said.out, said.err)

    return run


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of maps and data that are other people's and never committed."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip("../shared (maps and data of others) is not on this machine")
    return folder
