"""Two results are compared by what their metrics mean; those of two machines by their ratios."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.compare import compare_files, compare_results
from benchmarks.registry import machine
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentOptions, make_result, write_result

BEFORE = {
    "tick_ms": 10.0,
    "steps_per_s": 1000.0,
    "start_s": 2.0,
    "ratio_to_peer": 1.0,
    "tick_max_ms": 50.0,
    "gone_ms": 1.0,
}


def saved(folder: Path, name: str, metrics: dict[str, Any], quick: bool = False, **config: Any) -> Path:
    settings = {"machine": machine()} | config
    write_result(
        folder / name, make_result("bench_mppi", ExperimentOptions(quick=quick), settings, metrics, paper={}, rows=[])
    )
    return folder / name


def test_a_longer_time_and_a_lower_rate_are_slower(tmp_path: Path) -> None:
    old = saved(tmp_path, "old.json", BEFORE)
    new = saved(tmp_path, "new.json", {"tick_ms": 12.5, "steps_per_s": 790.0, "start_s": 1.0, "ratio_to_peer": 9.0,
                                       "tick_max_ms": 500.0, "gone_ms": None})  # fmt: skip
    text, slower = compare_files([old, new])
    assert slower
    flagged = [line.split()[0] for line in text.splitlines() if line.endswith("SLOWER")]
    assert flagged == ["steps_per_s", "tick_ms"]
    assert "start_s" in text and "ratio" not in text and "tick_max" not in text and "gone" not in text
    assert text.endswith("2 of 3 are slower by more than 20 %")


def test_a_fifth_is_let_pass_and_faster_is_no_fault(tmp_path: Path) -> None:
    old = saved(tmp_path, "old.json", BEFORE)
    new = saved(tmp_path, "new.json", {"tick_ms": 11.9, "steps_per_s": 3000.0})
    text, slower = compare_files([old, new])
    assert not slower and "SLOWER" not in text
    assert compare_files([new, old])[1]


@pytest.mark.parametrize("slower", [1.4, 1.6])
def test_a_step_half_again_as_slow_shows_on_another_machine(tmp_path: Path, slower: float) -> None:
    old = saved(tmp_path, "old.json", BEFORE | {"ratio_to_ideal": 1.0})
    changed = BEFORE | {"ratio_to_peer": slower, "ratio_to_ideal": 9.0, "tick_ms": 90.0}
    new = saved(tmp_path, "new.json", changed, machine={"processor": "other"})
    text, flagged = compare_files([old, new], ratios=True)
    assert flagged == (slower > 1.5) and "tick" not in text and "ideal" not in text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"machine": {"processor": "another", "cores": 2, "device": "cpu"}}, "different machines"),
        ({"quick": True}, "different benchmarks or sizes"),
        ({"metrics": {"other_ms": 1.0}}, "nothing in common"),
    ],
)
def test_what_can_not_be_compared_is_refused(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    old = saved(tmp_path, "old.json", BEFORE)
    new = saved(tmp_path, "new.json", change.pop("metrics", BEFORE), **change)
    with pytest.raises(ShmooError, match=words):
        compare_files([old, new])


def test_wrong_files_are_named(tmp_path: Path) -> None:
    old = saved(tmp_path, "old.json", BEFORE)
    with pytest.raises(ShmooError, match="two files"):
        compare_files([old])
    with pytest.raises(ShmooError, match=r"absent\.json: does not exist"):
        compare_files([old, tmp_path / "absent.json"])
    (tmp_path / "notes.json").write_text("{}")
    with pytest.raises(ShmooError, match=r"notes\.json: .*give a file that shmoo bench wrote"):
        compare_files([old, tmp_path / "notes.json"])
    other = make_result("pushing", ExperimentOptions(), {}, {"tick_ms": 1.0}, paper={}, rows=[])
    write_result(tmp_path / "pushing.json", other)
    with pytest.raises(ShmooError, match=r"pushing\.json: is no benchmark"):
        compare_files([old, tmp_path / "pushing.json"])
    assert compare_results(other, other)[0].slower == 1.0
