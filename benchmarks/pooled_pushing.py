"""Ours beside another method over several results of `shmoo experiment pushing`, all trials together.

Run: python benchmarks/pooled_pushing.py METHOD A.json B.json.gz ...
"""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import median
from typing import Any

from shmoo_mjx.evaluation.paired import OURS, PairedDifference, paired_difference
from shmoo_mjx.evaluation.result import read_result
from shmoo_mjx.report.tables import markdown_table

FIELDS = ("success", "offset_m", "yaw_error_deg", "time_s")
GROUPS = ("stratum", "family", "change")
"""Columns of a trial by whose values its pairs are also compared apart."""


def main() -> None:
    pairs: list[tuple[dict[str, Any], dict[str, Any]]] = []
    theirs, *files = sys.argv[1:]
    for file in files:
        by_method = {
            method: {row["trial"]: row for row in read_result(Path(file)).rows if row["method"] == method}
            for method in (OURS, theirs)
        }
        pairs += [(row, by_method[theirs][trial]) for trial, row in by_method[OURS].items()]
    subsets = {"all": pairs}
    for key in GROUPS:
        for value in dict.fromkeys(row[key] for row, _ in pairs):
            subsets[f"{key} {value}"] = [pair for pair in pairs if pair[0][key] == value]
    rows = []
    for name, subset in subsets.items():
        for field in FIELDS:
            mine, other = ([float(row[field]) for row in side] for side in zip(*subset, strict=True))
            # What is compared with nothing is a mean with its interval.
            means = [f"{_cell(paired_difference(x, [0.0] * len(x)))}, median {median(x):.3f}" for x in (mine, other)]
            rows.append([name, str(len(subset)), field, *means, _cell(paired_difference(mine, other))])
    print(markdown_table(["", "trials", "", OURS, theirs, "difference"], rows))


def _cell(found: PairedDifference | None) -> str:
    return "" if found is None else f"{found.mean:.3f} ({found.low:.3f} to {found.high:.3f})"


if __name__ == "__main__":
    main()
