"""The page of results: what is on it, and running everything."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import everything, page
from shmoo_mjx.evaluation.page import summary
from shmoo_mjx.evaluation.registry import EXPERIMENTS, RELIABILITY
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, read_result
from shmoo_mjx.evaluation.tables import Effect, Table, effects, number

DOCS = Path(__file__).parents[2] / "docs"


def result_of(name: str, options: ExperimentOptions) -> ExperimentResult:
    """A result with every metric that the page shows."""
    tables = [table for table in page.sections()[name].tables if isinstance(table, Table)]
    metrics = {metric: 0.25 for table in tables for _, names in table.lines for metric in names if metric}
    if name == "object_model":
        metrics |= {"mse_after": 0.134, "mse_after_std": 0.0021}
    if name == "robot_finetune":
        metrics["mse_after"] = float("nan")
    if name == "ablations":
        metrics = {"mse_default": 0.5, "probe_inputs": 0.1, "probe_inputs_without_size": 0.1, "chance": 0.01}
    paper = {"mse_before": 1.3131, "mse_after": 0.4271} if name == "object_model" else {}
    return make_result(name, options, {"unseen": {"box": 1}, "seeds": 1}, metrics, paper=paper, rows=[])


def run_fake(name: str, options: ExperimentOptions) -> ExperimentResult:
    """Stands for an experiment, with a figure."""
    if name == "navigation" and options.maps is None:
        raise ShmooError("experiment navigation needs --maps DIR.")
    if name == "real_pushing" and options.data is None:
        raise ShmooError("real_pushing needs --data.")
    for figure in list(page.sections()[name].figures)[:1]:
        target = options.out / name / figure
        target.parent.mkdir(parents=True, exist_ok=True)
        import matplotlib.image

        matplotlib.image.imsave(target, np.zeros((2, 2, 3)))
    options.progress("half", 0.5)
    return result_of(name, options)


def test_every_experiment_has_a_section_and_a_protocol() -> None:
    sections = page.sections()
    assert list(sections) == [*EXPERIMENTS, *RELIABILITY]
    protocols = (DOCS / "protocols.md").read_text()
    assert all(f"\n## {section.title}\n" in protocols for section in sections.values())


def test_a_result_of_other_weights_says_so() -> None:
    result = result_of("pushing", ExperimentOptions())
    warning = "Measured with a development snapshot of code and weights"
    assert warning not in page.render({"pushing": result}, {})
    result.config["weights"] = "0123456789"
    assert warning in page.render({"pushing": result}, {})
    del result.config["weights"]
    assert warning in page.render({"pushing": result}, {})
    # Its psi, for other inputs, is trained on the spot.
    other = result_of("real_pushing", ExperimentOptions())
    other.config["weights"] = "0123456789"
    assert warning not in page.render({"real_pushing": other}, {})


def test_everything_is_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(everything, "run_experiment", run_fake)
    seen: list[float] = []
    options = ExperimentOptions(
        seed=3, out=tmp_path, quick=True, progress=lambda stage, fraction: seen.append(fraction)
    )
    target, left_out = everything.run_all(options, None)
    assert set(left_out) == {"navigation", "real_pushing"} and "--maps" in left_out["navigation"]
    text, html = target.read_text(), target.with_suffix(".html").read_text()
    assert "| Mean squared error of the acceleration | 0.25 | 0.13 ± 0.0021 | 0.25 | 1.31 / 0.427 |" in text
    assert "| Mean squared error, all outputs | 0.25 | - |" in text
    assert "`shmoo experiment pushing --seed 3 --condition-seed 0 --quick`" in text
    assert "Not run. `shmoo experiment navigation --maps DIR` measures it." in text
    assert "(object_model/roll_outs.png)" in text and "data:image/png;base64" in html and "<table>" in html
    assert read_result(tmp_path / "pushing.json").seed == 3 and not (tmp_path / "navigation.json").exists()
    assert seen == sorted(seen)


def test_page_kept_apart_from_the_run_copies_its_figures(tmp_path: Path) -> None:
    run_fake("pushing", ExperimentOptions(out=tmp_path / "run"))
    results = {"pushing": result_of("pushing", ExperimentOptions())}
    page.write_page(results, tmp_path / "run", tmp_path / "docs" / "results.md", tmp_path / "docs" / "figures")
    assert "(figures/pushing.png)" in (tmp_path / "docs" / "results.md").read_text()
    assert (tmp_path / "docs" / "figures" / "pushing.png").is_file()


def test_a_section_without_a_result_stays_and_results_are_kept_beside_the_page(tmp_path: Path) -> None:
    docs, run = tmp_path / "docs", tmp_path / "run"
    run_fake("pushing", ExperimentOptions(out=run))
    run_fake("object_model", ExperimentOptions(out=run))
    page.write_page({"pushing": result_of("pushing", ExperimentOptions())}, run, docs / "results.md", docs / "figures")
    first = (docs / "results.md").read_text()
    other = {"object_model": result_of("object_model", ExperimentOptions())}
    page.write_page(other, run, docs / "results.md", docs / "figures")
    section = page.sections()["pushing"]
    pushing = section.tables[0](read_result(docs / "results" / "pushing.json.gz"))
    text = (docs / "results.md").read_text()
    assert pushing in first and pushing in text and "(figures/pushing.png)" in text
    assert section.tables[1](read_result(docs / "results" / "pushing.json.gz")) not in text
    assert (
        section.tables[1](read_result(docs / "results" / "pushing.json.gz"))
        in (docs / "results/pushing.md").read_text()
    )
    assert set(page.read_results(docs / "results")) == {"pushing", "object_model"}


def test_the_committed_pages_are_those_of_the_committed_results(tmp_path: Path) -> None:
    results = page.read_results(DOCS / "results")
    assert len(results) > 5
    docs = tmp_path / "docs"
    shutil.copytree(DOCS / "figures", docs / "figures")
    written = ["docs/results.md", "docs/protocols.md", "docs/arena.md", "README.md"]
    for name in written:
        shutil.copy(DOCS.parent / name, tmp_path / name)
    (docs / "results").mkdir()
    shutil.copy(DOCS / "results" / page.COST_TERMS, docs / "results")
    page.write_page(results, DOCS / "results", docs / "results.md", docs / "figures")
    for name in [*written, *(f"docs/results/{result}.md" for result in results)]:
        remedy = f"{name}: run python -m shmoo_mjx.evaluation.page docs/results docs/results.md"
        assert (tmp_path / name).read_text() == (DOCS.parent / name).read_text(), remedy
        assert len((tmp_path / name).read_text().splitlines()) <= 250, name


def test_the_summary_shows_at_most_ten_numbers_and_skips_what_was_not_measured() -> None:
    results = page.read_results(DOCS / "results")
    rows = summary(results)
    assert 5 < len(rows) <= 10 and all(row.trials > 0 for row in rows)
    pushing = results["pushing"]
    fewer = {name: v for name, v in pushing.metrics.items() if not name.startswith("difference_frozen_prior")}
    alone = summary({"pushing": pushing.model_copy(update={"metrics": fewer | {"offset_median_m": None}})})
    assert [row.label for row in alone] == [
        "Success rate of pushing to a pose, objects without a locked wheel, up to 43 N",
        "Success rate of pushing to a pose, objects as drawn",
    ]
    assert not summary({}) and not summary({"lifelong": results["lifelong"]})


def test_the_summary_gives_values_with_intervals() -> None:
    navigation = {
        "success_rate_certified": 0.9,
        "certified": 100.0,
        "difference_always_avoid_success": 0.125,
        "difference_always_avoid_success_low": -0.034,
        "difference_always_avoid_success_high": 0.2,
        "difference_always_avoid_success_pairs": 80.0,
    }
    pushing = {"trials": 30.0, "offset_m": 0.1, "offset_median_m": 0.054}
    paper = {"offset_goal1_m": 0.1, "offset_goal2_m": 0.12, "offset_goal3_m": 0.14}
    results = {
        "navigation": make_result("navigation", ExperimentOptions(), {}, navigation, paper={}, rows=[]),
        "pushing": make_result("pushing", ExperimentOptions(), {}, pushing, paper=paper, rows=[]),
    }
    # Wilson's interval of 90 in 100 is 0.826 to 0.945.
    assert [row[2:] for row in summary(results)] == [
        ("90 % (83 to 94)", 100, ""),
        ("+12 points (-3.4 to 20)", 80, ""),
        ("10 cm (median 5.4 cm)", 30, "12 cm"),
    ]
    readme = "# A\n\n<!-- results -->\nold\n<!-- end -->\n\nkept\n"
    text = page.with_block(readme, page.summary_table(results, links=False))
    assert "old" not in text and text.endswith("<!-- end -->\n\nkept\n") and "+12 points" in text
    assert page.with_block(text, page.summary_table(results, links=False)) == text
    assert "](#interactive-navigation)" in page.summary_table(results)


def test_faults_and_soak_have_their_tables_on_the_page(tmp_path: Path) -> None:
    about = {"runs": 2, "faults": {"camera_gone": "no object is detected for 5 s", "door_closes": "a door closes"}}
    rows = [
        {"fault": "camera_gone", "outcome": "recovered", "reason": "goal reached", "wall_contacts": 3},
        {"fault": "camera_gone", "outcome": "failed", "reason": "fell", "wall_contacts": 0},
        {"fault": "door_closes", "outcome": "stopped safely", "reason": "blocked", "wall_contacts": 0},
    ]
    faults = make_result(
        "faults", ExperimentOptions(seed=900), about, {"falls": 1, "silent_wrong_successes": 0}, paper={}, rows=rows
    )
    names = ("errands", "done", "falls", "livelocks", "wall_contacts", "memory_growth", "open_files_left")
    building = {"seed": 950, **dict.fromkeys(names, 7), "given_up": ["blocked", "blocked"]}
    kind = {"minutes": 60.0, "buildings": 10}
    soak = make_result("soak", ExperimentOptions(seed=950), kind, {"falls": 0}, paper={}, rows=[building])
    docs = tmp_path / "docs"
    page.write_page({"faults": faults, "soak": soak}, tmp_path, docs / "results.md", docs / "figures")
    text = (docs / "results.md").read_text()
    assert "`shmoo experiment faults --runs 2 --seed 900`" in text
    assert "| 2 | 3 | 1 | 1 | 1 | 0 | 1 | 0 |" in text and text.index("## Faults") < text.index("## Soak")
    assert "`shmoo experiment soak --minutes 60 --buildings 10 --seed 950`" in text
    kept = page.read_results(docs / "results")
    full = {name: page.render_experiment(kept[name], []) for name in ("faults", "soak")}
    assert all((docs / "results" / f"{name}.md").read_text() == shown for name, shown in full.items())
    assert "| no object is detected for 5 s | 1 | 0 | 1 | 0 | 1 | fell |" in full["faults"]
    assert "3 runs: 1 falls" in full["faults"] and "2 x blocked" in full["soak"]


def test_a_method_that_did_not_run_has_no_column() -> None:
    alone = result_of("pushing", ExperimentOptions())
    ours = {name: value for name, value in alone.metrics.items() if not name.startswith("baseline_")}
    table = page.sections()["pushing"].tables[0]
    shown = table(alone.model_copy(update={"metrics": ours}))
    assert "| | ours |\n|---|---|\n" in shown and "quasi-static" not in shown
    assert "| ours | no adaptation | contact model without psi |" in table(alone)


def test_effects_are_told_by_their_intervals() -> None:
    metrics = {"d_time": -4.2, "d_time_low": -7.6, "d_time_high": -0.9, "d_rate": 0.03, "d_rate_low": -0.1}
    measures = (
        Effect("the time", "time", "s"),
        Effect("the rate", "rate", "points", 100.0),
        Effect("the yaw", "yaw", ""),
    )
    made = make_result("pushing", ExperimentOptions(), {}, metrics | {"d_rate_high": 0.2}, paper={}, rows=[])
    assert effects(made, "Ours", "d_", measures) == (
        "Ours lowers the time by 4.2 s (0.90 to 7.6). It has no clear effect on the rate (+3 points, -10 to 20)."
    )
    assert effects(made, "Ours", "other_", measures) == ""


def test_numbers_have_two_significant_digits() -> None:
    assert [number(v) for v in (0.1, 0.0826, 3.0, 12.34, 153.0, 1213.4, -0.5)] == [
        "0.10", "0.083", "3", "12", "153", "1213", "-0.50",
    ]  # fmt: skip


def test_nothing_could_be_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str, options: ExperimentOptions) -> ExperimentResult:
        raise ShmooError("no.")

    monkeypatch.setattr(everything, "run_experiment", refuse)
    with pytest.raises(ShmooError, match="nothing could be run"):
        everything.run_all(ExperimentOptions(out=tmp_path), None)
