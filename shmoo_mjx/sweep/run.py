"""A sweep as a list of shards, each with an atomically written result file.

A shard is a range of worlds of one family with one controller. Any process can compute a missing shard: after an
interruption, on another machine, or in parallel jobs. Complete sweeps are collected into one table and figures.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.guard import PNG, SWEEP, TABLE, TEXT, check_folder
from shmoo_mjx.base.versions import versions
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.sweep.config import SweepConfig, sweep_fingerprint
from shmoo_mjx.sweep.worlds import draw, label

if TYPE_CHECKING:
    from shmoo_mjx.sweep.simulate import Batches

NOTES = "sweep.json"
"""File that is written first into a sweep's folder."""
_FILES = {NOTES: SWEEP, "results.parquet": TABLE, "summary.txt": TEXT, "parameters.png": PNG, "map.png": PNG}


class Shard(NamedTuple):
    """Worlds first .. first + worlds - 1 of one family with one controller."""

    family: str
    controller: str
    first: int
    worlds: int

    @property
    def name(self) -> str:
        """Name of the shard's file, without suffix."""
        return f"{label(self.family)}-{self.controller}-{self.first:07d}-{self.worlds}"


class Estimate(NamedTuple):
    """Estimated time and memory for the missing shards of one family and controller."""

    family: str
    controller: str
    worlds: int
    """Number of worlds to compute."""
    batch: int
    """Number of worlds per batch."""
    bytes: int
    """Memory of a batch on all devices [bytes]."""
    free: int
    """Available memory on all devices [bytes]."""
    seconds: float
    """Estimated computing time [s]."""

    def __str__(self) -> str:
        each, whole = self.bytes / self.batch / 1e6, self.bytes / 1e9
        text = f"{label(self.family)}, {self.controller}: {self.worlds} worlds in batches of {self.batch}"
        text += f", {each:.2g} MB a world, {whole:.2g} of {self.free / 1e9:.3g} GB"
        return f"{text}, about {duration(self.seconds)}"


@dataclass(frozen=True)
class Sweep:
    """A sweep and its output folder."""

    config: SweepConfig
    """Configuration of the sweep."""
    out: Path
    """Output folder."""
    weights: Path
    """File with the weights of the learned model."""

    @classmethod
    def open(cls, config: SweepConfig, out: Path, weights: Path | None = None) -> Sweep:
        """Start a sweep in the folder ``out``, or resume the one there.

        Args:
            config: configuration of the sweep.
            out: output folder.
            weights: file with the weights of the learned model, by default the shipped ones.

        Raises:
            ShmooError: the weights file does not exist, or ``out`` contains another sweep or other files.
        """
        check_folder(out, _FILES, NOTES)
        sweep = cls(config, out, Path(weights or asset(WEIGHTS)))
        if not sweep.weights.is_file():
            raise ShmooError(f"{sweep.weights}: there is no such weights file; give one that shmoo train made.")
        notes, mark = out / NOTES, sweep_fingerprint(config, sweep.weights)
        settings = config.model_dump(mode="json")
        settings["families"] = [os.path.relpath(f, out) if f.endswith(".json") else f for f in config.families]
        values = {"fingerprint": mark, "config": settings, "versions": versions()}
        present = json.loads(notes.read_text()) if notes.exists() else {}
        if present.get("fingerprint", mark) != mark:
            raise ShmooError(f"{out}: holds another sweep, or this one with other settings; choose another --out.")
        if present != values:
            write_whole(notes, json.dumps(values, indent=1).encode())
        return sweep

    @property
    def shards(self) -> list[Shard]:
        """All shards, in the order of the rows."""
        cfg = self.config
        return [
            Shard(family, controller, first, min(cfg.shard, cfg.worlds - first))
            for family in cfg.families
            for controller in cfg.controllers
            for first in range(0, cfg.worlds, cfg.shard)
        ]

    def file(self, shard: Shard) -> Path:
        """Path of a shard's rows."""
        return self.out / "shards" / f"{shard.name}.parquet"

    def missing(self, part: tuple[int, int] = (0, 1)) -> list[Shard]:
        """Shards without a result file; with ``part`` (k, n), only those of the k-th of n jobs."""
        mine = self.shards[part[0] :: part[1]]
        return [s for s in mine if not self.file(s).exists()]

    def collect(self) -> Path:
        """Write all rows to one file and return its path. All shards must be complete."""
        tables = [_read(self.file(s)) for s in self.shards]
        whole = pa.concat_tables(tables, promote_options="default")
        path = self.out / "results.parquet"
        write_whole(path, _written(whole.replace_schema_metadata(tables[0].schema.metadata)))
        return path

    def write(self, shard: Shard, rows: list[dict[str, Any]]) -> None:
        """Write a shard's rows atomically."""
        named = [{"family": label(shard.family), "controller": shard.controller, **row} for row in rows]
        table = pa.Table.from_pylist(named).replace_schema_metadata({"sweep": self.config.model_dump_json()})
        write_whole(self.file(shard), _written(table))


class ShardRunner:
    """Computes missing shards in this process.

    Args:
        sweep: sweep to compute.
        part: (k, n) to compute only the shards of the k-th of n jobs.
        make: function (family, controller) -> simulator, by default MJX on all devices.
        memory: memory that a batch may use on all devices together [bytes], by default the free memory.
    """

    def __init__(
        self,
        sweep: Sweep,
        part: tuple[int, int] = (0, 1),
        make: Callable[[str, str], Batches] | None = None,
        memory: int | None = None,
    ) -> None:
        self.sweep = sweep
        self.missing = sweep.missing(part)
        self._simulator = cache(make or _mjx(sweep, memory))

    def estimate(self) -> Iterator[Estimate]:
        """Compile the program of each family and controller, and yield its estimated time and memory."""
        for family, controller in dict.fromkeys((s.family, s.controller) for s in self.missing):
            mine = [s for s in self.missing if (s.family, s.controller) == (family, controller)]
            simulator = self._simulator(family, controller)
            batches = sum(-(-s.worlds // simulator.batch) for s in mine)
            worlds = sum(s.worlds for s in mine)
            seconds = batches * simulator.time_one()
            yield Estimate(family, controller, worlds, simulator.batch, simulator.bytes, simulator.free, seconds)

    def run(self, progress: Callable[[str, float], None] = lambda stage, fraction: None) -> None:
        """Compute the missing shards one by one."""
        total = sum(s.worlds for s in self.missing)
        done = 0
        for shard in self.missing:
            stage = f"{label(shard.family)}, {shard.controller}: worlds from {shard.first}"
            worlds = [draw(self.sweep.config, shard.family, i) for i in range(shard.first, shard.first + shard.worlds)]
            simulator = self._simulator(shard.family, shard.controller)

            def report(fraction: float, stage: str = stage, before: int = done, count: int = shard.worlds) -> None:
                progress(stage, (before + fraction * count) / total)

            report(0.0)
            self.sweep.write(shard, simulator.run(worlds, report))
            report(1.0)
            done += shard.worlds


def _mjx(sweep: Sweep, memory: int | None) -> Callable[[str, str], Batches]:
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.sweep.simulate import Batches

    weights = load_weights(sweep.weights)
    return lambda family, controller: Batches(sweep.config, family, controller, weights, memory=memory)


def read_table(path: Path) -> dict[str, list[Any]]:
    """Columns of a Parquet file."""
    return _read(path).to_pydict()


def _read(path: Path) -> Any:
    try:
        return pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        reason = str(error).splitlines()[0]
        raise ShmooError(f"{path}: can't be read as Parquet ({reason}); delete it and run the sweep again.") from None


def _written(table: Any) -> bytes:
    buffer = pa.BufferOutputStream()
    pq.write_table(table, buffer)
    return buffer.getvalue().to_pybytes()


def duration(seconds: float) -> str:
    """Format a duration [s] in s, min or h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
