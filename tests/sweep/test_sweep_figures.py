"""Figures and the summary say what the rows say."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from shmoo_mjx.report.style import to_png
from shmoo_mjx.sweep import figures
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.figures import binned, cells, draw_figures, rate, summary
from shmoo_mjx.sweep.run import ShardRunner, Sweep, read_table


@pytest.fixture
def table(config: SweepConfig, tmp_path: Path, pretend: Any) -> dict[str, list[Any]]:
    sweep = Sweep.open(config, tmp_path / "sweep")
    ShardRunner(sweep, make=lambda family, controller: pretend).run()
    return read_table(sweep.collect())


def test_wilsons_interval() -> None:
    share, low, high = rate([0, 5, 10, 0], [10, 10, 10, 0])
    np.testing.assert_allclose(share[:3], [0, 0.5, 1])
    np.testing.assert_allclose(low[:3], [0, 0.2366, 0.7225], atol=1e-4)
    np.testing.assert_allclose(high[:3], [0.2775, 0.7634, 1], atol=1e-4)
    assert np.isnan(share[3])


def test_bins_hold_all_worlds() -> None:
    values = np.random.default_rng(0).lognormal(size=100)
    middle, happened, trials = binned(values, values > 1, bins=4)
    assert trials.tolist() == [25] * 4 and happened.sum() == (values > 1).sum()
    assert np.all(np.diff(middle) > 0) and happened[0] == 0 and happened[-1] == 25
    middle, happened, trials = binned([0.1, 0.0, 0.1], [True, False, False])
    assert (middle.tolist(), happened.tolist(), trials.tolist()) == ([0.0, 0.1], [0, 1], [1, 2])


def test_cells_count_each_world_once(table: dict[str, list[Any]]) -> None:
    mine = np.array(table["family"]) == "cart"
    x, _, successes, trials = cells(("object.mass", "object.friction"), table, mine)
    assert trials.sum() == 11 and successes.sum() == np.array(table["success"])[mine].sum()
    assert successes[:, np.searchsorted(x, 12.0) :].sum() == 0


def test_the_summary_counts_outcomes(config: SweepConfig, table: dict[str, list[Any]]) -> None:
    text = summary(config, table).splitlines()
    assert text[0] == "how heavy?"
    for line, family in zip(text[2:4], ("box", "cart"), strict=True):
        outcomes = [o for o, f in zip(table["outcome"], table["family"], strict=True) if f == family]
        numbers = line.split()
        assert numbers[:3] == [family, "ours", "11"]
        assert float(numbers[3]) == pytest.approx(outcomes.count("success") / 11, abs=5e-4)
        assert [int(n) for n in numbers[6:]] == [outcomes.count(o) for o in
                                                 ("astray", "stuck", "unfelt", "fell", "unstable")]  # fmt: skip


def test_figures_are_drawn(config: SweepConfig, table: dict[str, list[Any]], tmp_path: Path) -> None:
    paths = draw_figures(config, table, tmp_path)
    assert [p.name for p in paths] == ["parameters.png", "map.png"]
    for path in paths:
        picture = np.asarray(Image.open(path).convert("RGB"), dtype=float)
        assert picture.shape[0] > 300 and picture.std() > 10
    assert draw_figures(config.model_copy(update={"vary": {}, "map": None}), table, tmp_path) == []


def test_every_family_has_its_line_whatever_its_name(
    config: SweepConfig, table: dict[str, list[Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(figures, "save_figure", lambda path, figure, dpi: (drawn.append(figure), path)[1])
    names = {"box": "_table", "cart": r"ta$\frac$ 桌子"}
    odd = table | {"family": [names[family] for family in table["family"]]}
    draw_figures(config.model_copy(update={"question": "$?$"}), odd, tmp_path)
    labels = {text.get_text() for text in drawn[0].legends[0].get_texts()}
    assert labels == {f"{what}: {name}, ours" for name in names.values() for what in ("success", "fall")}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert all(to_png(figure).startswith(b"\x89PNG") for figure in drawn)
