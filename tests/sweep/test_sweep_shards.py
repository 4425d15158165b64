"""Shards: each once, whole or not at all, whoever computes it and however often it is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.sweep import run
from shmoo_mjx.sweep.config import SweepConfig, load_sweep
from shmoo_mjx.sweep.run import ShardRunner, Sweep, read_table


def finish(sweep: Sweep, pretend: Any, part: tuple[int, int] = (0, 1)) -> ShardRunner:
    runner = ShardRunner(sweep, part, lambda family, controller: pretend)
    runner.run()
    return runner


def test_shards_cover_every_world_once(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    sweep = Sweep.open(config, tmp_path)
    assert [(s.family, s.first, s.worlds) for s in sweep.shards] == [
        (f, a, n) for f in ("box", "cart") for a, n in ((0, 5), (5, 5), (10, 1))
    ]
    finish(sweep, pretend)
    table = read_table(sweep.collect())
    assert list(zip(table["family"], table["world"], strict=True)) == [
        (f, i) for f in ("box", "cart") for i in range(11)
    ]
    assert pretend.simulated == [*range(11), *range(11)]
    assert table["object.rolling"][0] is None and table["object.rolling"][-1] > 0


def test_the_cut_does_not_change_the_table(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    tables = []
    for shard in (5, 11, 1):
        sweep = Sweep.open(config.model_copy(update={"shard": shard}), tmp_path / str(shard))
        finish(sweep, pretend)
        tables.append(read_table(sweep.collect()))
    assert tables[0] == tables[1] == tables[2]


def test_only_what_is_missing_is_computed(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    sweep = Sweep.open(config, tmp_path)
    finish(sweep, pretend)
    sweep.file(sweep.shards[1]).unlink()
    pretend.simulated.clear()
    again = finish(Sweep.open(config, tmp_path), pretend)
    assert [s.first for s in again.missing] == [5] and pretend.simulated == [5, 6, 7, 8, 9]


def test_a_sweep_goes_on_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An own object counts by what its file holds, not by the way to it."""
    (tmp_path / "inner").mkdir()
    (tmp_path / "thing.json").write_text("{}")
    (tmp_path / "sweep.yaml").write_text("worlds: 2\nfamilies: [thing.json]\n")
    written = []
    for here, way in (("", ""), ("inner", "../"), ("", f"{tmp_path}/")):
        monkeypatch.chdir(tmp_path / here)
        Sweep.open(load_sweep(f"{way}sweep.yaml"), Path(f"{way}out"))
        written.append((tmp_path / "out" / "sweep.json").read_text())
    assert len(set(written)) == 1 and str(tmp_path) not in written[0]
    (tmp_path / "thing.json").write_text('{"other": 1}')
    with pytest.raises(ShmooError, match="another sweep"):
        Sweep.open(load_sweep("sweep.yaml"), Path("out"))


def test_more_worlds_keep_the_full_shards(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    finish(Sweep.open(config, tmp_path), pretend)
    more = Sweep.open(config.model_copy(update={"worlds": 15}), tmp_path)
    assert [(s.family, s.first) for s in more.missing()] == [("box", 10), ("cart", 10)]


def test_jobs_part_the_shards_among_themselves(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    sweep = Sweep.open(config, tmp_path)
    parts = [sweep.missing((k, 4)) for k in range(4)]
    assert sorted(shard for part in parts for shard in part) == sorted(sweep.shards)
    finish(sweep, pretend, (1, 4))
    # Which shards are a job's own doesn't depend on what is there already.
    assert sweep.missing((1, 4)) == [] and sweep.missing((2, 4)) == parts[2]


def test_the_estimate_counts_batches_and_memory(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    sweep = Sweep.open(config, tmp_path)
    first, second = ShardRunner(sweep, make=lambda family, controller: pretend).estimate()
    # Shards of 5, 5 and 1 worlds in batches of 4 take 2, 2 and 1 of them, 2 s each.
    assert (first.worlds, first.seconds, second.seconds) == (11, 10.0, 10.0)
    assert str(first) == "box, ours: 11 worlds in batches of 4, 1 MB a world, 0.004 of 1 GB, about 10 s"


def test_another_sweep_does_not_mix_in(config: SweepConfig, tmp_path: Path) -> None:
    Sweep.open(config, tmp_path)
    Sweep.open(config.model_copy(update={"question": "said otherwise"}), tmp_path)
    with pytest.raises(ShmooError, match="another sweep"):
        Sweep.open(config.model_copy(update={"seed": 3}), tmp_path)


def test_a_damaged_shard_is_named(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    sweep = Sweep.open(config, tmp_path)
    finish(sweep, pretend)
    damaged = sweep.file(sweep.shards[2])
    damaged.write_bytes(damaged.read_bytes()[:100])
    with pytest.raises(ShmooError, match=f"{damaged.name}.*delete it"):
        sweep.collect()


SLOWLY = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from conftest import Pretend
from shmoo_mjx.sweep.config import SweepConfig, load_sweep
from shmoo_mjx.sweep.run import ShardRunner, Sweep
class Slow(Pretend):
    def run(self, worlds, progress=lambda fraction: None):
        time.sleep(0.3)
        return super().run(worlds, progress)
config = SweepConfig.model_validate_json(sys.stdin.read())
ShardRunner(Sweep.open(config, Path(sys.argv[1])), make=lambda family, controller: Slow()).run()
"""


@pytest.mark.slow
def test_killed_it_goes_on_and_ends_as_if_it_had_not_been(config: SweepConfig, tmp_path: Path, pretend: Any) -> None:
    killed, whole = tmp_path / "killed", Sweep.open(config, tmp_path / "whole")
    finish(whole, pretend)
    command = [sys.executable, "-c", SLOWLY, str(killed), str(Path(__file__).parent)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE)
    assert process.stdin is not None
    process.stdin.write(config.model_dump_json().encode())
    process.stdin.close()
    until = time.monotonic() + 300  # a busy machine takes long to begin
    while not list(killed.glob("shards/*.parquet")) and time.monotonic() < until:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    sweep = Sweep.open(config, killed)
    left = sweep.missing()
    assert 0 < len(left) < len(sweep.shards)
    pretend.simulated.clear()
    finish(sweep, pretend)
    assert len(pretend.simulated) == sum(s.worlds for s in left)
    assert read_table(sweep.collect()) == read_table(whole.collect())
    assert not [p for p in killed.rglob("*") if p.name.startswith(".") or p.suffix == ".tmp"]


def test_jobs_of_a_cluster_make_the_same_table(
    config: SweepConfig, tmp_path: Path, pretend: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster = pytest.importorskip("shmoo_mjx.sweep.cluster")
    pytest.importorskip("submitit")
    whole, shared = Sweep.open(config, tmp_path / "whole"), Sweep.open(config, tmp_path / "shared")
    finish(whole, pretend)
    pretend.simulated.clear()
    monkeypatch.setattr(run, "_mjx", lambda sweep, memory: lambda family, controller: pretend)
    seen: list[float] = []
    cluster.submit(
        shared, 4, "debug", options={"timeout_min": 5}, progress=lambda stage, fraction: seen.append(fraction)
    )
    assert seen[-1] == 1.0 and sorted(pretend.simulated) == sorted([*range(11), *range(11)])
    assert read_table(shared.collect()) == read_table(whole.collect())


@pytest.mark.slow
def test_a_failed_job_is_told_in_one_sentence(config: SweepConfig, tmp_path: Path) -> None:
    cluster = pytest.importorskip("shmoo_mjx.sweep.cluster")
    pytest.importorskip("submitit")
    weights = tmp_path / "weights.safetensors"
    weights.write_bytes(b"no weights")
    with pytest.raises(ShmooError, match=r"job \d+ failed \(.*weights.safetensors.*read it there") as caught:
        cluster.submit(Sweep.open(config, tmp_path / "out", weights), 1, "local", options={"timeout_min": 5}, poll=0.2)
    assert "\n" not in str(caught.value)


def test_without_slurm_it_says_what_to_do(config: SweepConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = pytest.importorskip("shmoo_mjx.sweep.cluster")
    pytest.importorskip("submitit")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ShmooError, match=r"there is no slurm here.*--cluster local"):
        cluster.submit(Sweep.open(config, tmp_path), 2, "slurm", options={})
