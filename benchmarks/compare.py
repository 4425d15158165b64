"""Comparison of two results of one benchmark: which metrics have become slower.

The name of a metric shows its kind. Larger is better for ``..._per_s`` and ``..._gflops``, smaller is better for
``..._ms`` and ``..._s``. Memory and the worst single step are left out, because they vary by chance. Results of two
machines are compared by ratios to another program's time, such as ``ratio_to_plain_jax``. ``ratio_to_ideal`` is left
out there, because it depends on the processor (0.9 on one, 2.0 on another).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentResult, read_result

LIMIT = 1.2
"""Slowdown above which a metric is flagged."""
LIMIT_OF_RATIOS = 1.5
"""Slowdown above which a ratio is flagged. It is larger, because caches and vector units differ between machines."""


class Change(NamedTuple):
    """One metric in both results."""

    name: str
    before: float
    after: float
    slower: float
    """Slowdown: how many times as slow as before. Below 1 the metric has become faster."""


def compare_results(old: ExperimentResult, new: ExperimentResult, ratios: bool = False) -> list[Change]:
    """Changes of all times and rates that both results have, or of all ``ratios``, the largest slowdown first."""
    changes = []
    for name, before in old.metrics.items():
        after, kind = new.metrics.get(name), _kind(name, ratios)
        if before and after and kind:
            changes.append(Change(name, before, after, after / before if kind == "time" else before / after))
    return sorted(changes, key=lambda change: -change.slower)


def compare_files(files: Sequence[Path], ratios: bool = False) -> tuple[str, bool]:
    """The comparison as text, and whether any metric is slower than the limit allows.

    Args:
        files: the older and the newer result.
        ratios: whether to compare ratios instead of times and rates.

    Raises:
        ShmooError: not two files, no results of a benchmark, or results that can't be compared.
    """
    if len(files) != 2:
        raise ShmooError(f"bench compare needs two files, the older and the newer result, not {len(files)}.")
    old, new = (_read(path) for path in files)
    if old.experiment != new.experiment or old.config["quick"] != new.config["quick"]:
        raise ShmooError(f"{files[0]} and {files[1]}: are of different benchmarks or sizes; measure both alike.")
    if not ratios and old.config["machine"] != new.config["machine"]:
        raise ShmooError(f"{files[0]} and {files[1]}: are from different machines; compare them with --ratios.")
    changes = compare_results(old, new, ratios)
    if not changes:
        raise ShmooError(
            f"{files[0]} and {files[1]}: have nothing in common to compare; measure both with one version."
        )
    width = max(len(change.name) for change in changes)
    limit = LIMIT_OF_RATIOS if ratios else LIMIT
    lines = [f"{'metric':{width}}  {'before':>10}  {'after':>10}  {'slower':>6}"]
    lines += [
        f"{c.name:{width}}  {c.before:10.4g}  {c.after:10.4g}  {c.slower:6.2f}{'  SLOWER' if c.slower > limit else ''}"
        for c in changes
    ]
    flagged = sum(c.slower > limit for c in changes)
    lines.append(f"{flagged} of {len(changes)} are slower by more than {100 * (limit - 1):.0f} %")
    return "\n".join(lines), flagged > 0


def _read(path: Path) -> ExperimentResult:
    if not path.exists():
        raise ShmooError(f"{path}: does not exist; give a file that shmoo bench wrote.")
    result = read_result(path, "shmoo bench")
    if not result.experiment.startswith("bench_") or "machine" not in result.config:
        raise ShmooError(f"{path}: is no benchmark's result with its machine; give a file that shmoo bench wrote.")
    return result


def _kind(name: str, ratios: bool) -> str:
    if ratios:
        return "time" if name.startswith("ratio_") and not name.endswith("ideal") else ""
    if name.endswith(("_per_s", "_gflops")):
        return "rate"
    return "time" if name.endswith(("_ms", "_s")) and "max" not in name else ""
