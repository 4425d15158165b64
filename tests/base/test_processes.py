"""Worker processes end with the process they work for."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from shmoo_mjx.base.processes import process_pool

SCRIPT = """
import os, sys, time
from pathlib import Path
from shmoo_mjx.base.processes import process_pool

def work(folder):
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(120)

if __name__ == "__main__":
    with process_pool(2) as pool:
        list(pool.map(work, [sys.argv[1]] * 2))
"""


def _fail(name: str) -> None:
    raise ValueError(name)


def _alive(number: int) -> bool:
    try:
        state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_workers_of_a_killed_process_end(tmp_path: Path, how: signal.Signals) -> None:
    (tmp_path / "seen").mkdir()
    (tmp_path / "main.py").write_text(SCRIPT)
    parent = subprocess.Popen([sys.executable, str(tmp_path / "main.py"), str(tmp_path / "seen")])
    deadline = time.monotonic() + 60.0
    while len(os.listdir(tmp_path / "seen")) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    workers = [int(name) for name in os.listdir(tmp_path / "seen")]
    assert len(workers) == 2 and all(map(_alive, workers))
    parent.send_signal(how)
    parent.wait()
    deadline = time.monotonic() + 10.0
    while any(map(_alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(_alive, workers))


def test_an_error_in_a_worker_comes_through() -> None:
    with pytest.raises(ValueError, match="this one"), process_pool(1) as pool:
        pool.submit(_fail, "this one").result()


@pytest.mark.skipif(os.name != "posix", reason="needs signal masks")
def test_a_worker_is_deaf_to_ctrl_c_from_its_start() -> None:
    """A mask that is set before the worker exists. The parent's own stays as it was."""
    with process_pool(1) as pool:
        assert signal.SIGINT in pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


FORKED = """
import sys
import gymnasium
import jax.numpy as jnp
import numpy as np

if __name__ == "__main__":
    live, context = sys.argv[1] == "live", sys.argv[2]
    if live:
        jnp.zeros(3).sum().block_until_ready()
    worlds = gymnasium.make_vec(
        "shmoo_mjx.gym:ShmooPush-v0", num_envs=2, vectorization_mode="async", vector_kwargs={"context": context}
    )
    for _ in range(2):
        worlds.reset(seed=3)
        seen, *_ = worlds.step(np.zeros((2, 4), dtype=np.float32))
    print("seen", seen.shape)
    worlds.close()
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("live", "context"),
    [
        ("live", "fork"),
        pytest.param("live", "spawn", marks=pytest.mark.slow),
        pytest.param("idle", "fork", marks=pytest.mark.slow),
    ],
)
def test_environments_in_processes_run_or_say_why_they_can_t(tmp_path: Path, live: str, context: str) -> None:
    pytest.importorskip("gymnasium")
    (tmp_path / "main.py").write_text(FORKED)
    command = [sys.executable, "-W", "ignore", str(tmp_path / "main.py"), live, context]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if (live, context) == ("live", "fork"):
        last = done.stderr.strip().splitlines()[-1]
        assert done.returncode == 1 and "ShmooError" in last and "vector_kwargs={'context': 'spawn'}" in last
    else:
        assert done.returncode == 0 and "seen (2, 27)" in done.stdout


def test_every_pool_spawns_its_workers() -> None:
    """A forked process waits for ever for JAX's locks, if JAX has computed in its parent."""
    root = Path(__file__).resolve().parents[2]
    for source in (path for top in ("shmoo_mjx", "examples", "benchmarks") for path in (root / top).rglob("*.py")):
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            call = ast.unparse(node) if isinstance(node, ast.Call) else ""
            name = call.partition("(")[0].rpartition(".")[2]
            if name == "get_context":
                assert call.endswith("get_context('spawn')"), f"{source}: {call}"
            if name in ("ProcessPoolExecutor", "Pool"):
                assert "get_context('spawn')" in call or "mp_context=context" in call, f"{source}: {call}"
