"""The page's tables come from the JSON, and only where the page has a place for them."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.evaluation.baselines import METHODS
from shmoo_mjx.evaluation.baselines.experiment import EXPERIMENT, REPLAY, baselines_table
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, over_seeds


def result() -> ExperimentResult:
    config = {"unseen": {"box": 2}, "seeds": 3}
    metrics = {
        f"{m}_{n}": v
        for m in ("fvu", "fvu_median", "mse", "pos_rmse_3s_m", "yaw_rmse_3s_deg")
        for n, v in (("ours", 0.25), ("residual", 0.5))
    }
    metrics |= {"ratio_residual": 2.0, "fvu_std_ours": 0.01, "mse_prior": 0.4}
    rows = [{"method": "ours", "setting": {}}, {"method": "residual", "setting": {"ridge": 10.0}}]
    return make_result(
        "baselines", ExperimentOptions(seed=4), config, metrics, paper={"ratio_residual": 1.5}, rows=rows
    )


def test_a_line_says_what_a_method_reaches_with_which_setting_the_best_first() -> None:
    table = baselines_table(result())
    assert "| ours | 0.40 | 0.25 | 1 |  | 0.25 | 0.25 |" in table
    assert "| adaptive residual, with contact model |  | 0.50 | 2 | 1.5 | 0.50 | 0.50 |" in table
    assert table.index("| ours") < table.index("| adaptive")
    further = EXPERIMENT.section.tables[1](result())
    assert "| ours | 0.25 ± 0.010 | 0.25 | default |" in further and "2 unseen objects, 3 seeds." in further
    assert "| adaptive residual, with contact model | 0.50 | 0.50 | ridge 10.0 |" in further


def test_a_method_that_diverges_is_last_and_says_so() -> None:
    metrics = over_seeds("mse", "residual", [1.0, np.inf]) | over_seeds("mse", "ours", [1.0, 2.0])
    metrics |= over_seeds("pos_rmse_3s_m", "ours", [np.nan, np.nan])
    made = make_result("baselines", ExperimentOptions(), {"unseen": {"box": 2}, "seeds": 2}, metrics, paper={}, rows=[])
    ours, residual = [line.split("|") for line in baselines_table(made).splitlines()[2:4]]
    assert ours[1:4] == [" ours ", "  ", " 1.5 ± 0.50 "] and ours[6] == " - "
    assert residual[3] == " diverges "


def test_every_method_has_a_line() -> None:
    config = {"unseen": {"box": 2}, "seeds": 3}
    compared = [*METHODS, REPLAY]
    metrics = {f"mse_{name}": 1.0 + i for i, name in enumerate(compared)}
    lines = baselines_table(
        make_result("baselines", ExperimentOptions(), config, metrics, paper={}, rows=[])
    ).splitlines()
    assert len([line for line in lines if line.startswith("| ")]) == 1 + len(compared)
