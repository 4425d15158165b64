"""The tables of docs/performance.md are those of the committed results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import performance_page as maker

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_says_what_was_measured() -> None:
    text = maker.PAGE.read_text(encoding="utf-8")
    assert maker.page(text) == text, "run python -m benchmarks.performance_page"


def test_another_result_makes_another_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    result = json.loads((ROOT / "docs/results/bench_mppi_quick.json").read_text())
    result["metrics"] |= {"ours_ms": 3.0, "pytorch_mppi_eager_ms": 12.0, "64_problems_over_64_times_one": 0.66}
    (tmp_path / "bench_mppi.json").write_text(json.dumps(result))
    monkeypatch.setattr(maker, "RESULTS", tmp_path)
    text = maker.page(maker.PAGE.read_text(encoding="utf-8"))
    assert "| **ours, shipped networks** | 3.0 | 0.25 |" in text and "64 x one 0.66" in text
    with pytest.raises(SystemExit, match="has 0 blocks named control step"):
        maker.page("an empty page")
