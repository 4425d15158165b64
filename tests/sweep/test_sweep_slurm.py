"""A sweep's jobs on a real Slurm cluster, where there is one; a single machine with slurm-wlm will do."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from shmoo_mjx.sweep.run import read_table

SWEEP = """
worlds: 4
shard: 2
seconds: 2
controllers: {plain: {kind: quasi_static}}
vary: {object.mass: {uniform: [3, 9]}}
"""


@pytest.fixture
def cluster() -> None:
    """Skips where no controller answers."""
    pytest.importorskip("submitit", reason="the extra cluster (submitit) is not installed")
    if shutil.which("sbatch") is None:
        pytest.skip("sbatch is not on this machine")
    if subprocess.run(["scontrol", "ping"], capture_output=True, check=False).returncode:
        pytest.skip("sbatch is here, but no Slurm controller answers")


@pytest.mark.slow
def test_two_slurm_jobs_share_the_shards(cluster: None, tmp_path: Path) -> None:
    sweep, out = tmp_path / "small.yaml", tmp_path / "out"
    sweep.write_text(SWEEP)
    main = "from shmoo_mjx.cli import main; main()"
    words = ["sweep", str(sweep), "--out", str(out), "--jobs", "2", "--options", "timeout_min=20", "cpus_per_task=1"]
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": "1", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", main, *words], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert read_table(out / "results.parquet")["world"] == [0, 1, 2, 3]
    assert len(list(out.glob("shards/*.parquet"))) == 2
    # One job array of two, each of which has left its answer.
    assert len({p.name.split("_")[0] for p in out.glob("jobs/*_result.pkl")}) == 1
    assert len(list(out.glob("jobs/*_result.pkl"))) == 2
