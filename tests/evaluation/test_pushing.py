"""The pushing experiment: trials from seeds, changes mid-run, metrics, resuming, limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.behavior.methods import method_named
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import pushing, pushing_trials
from shmoo_mjx.evaluation.pushing_measures import enclosing_circle, metrics_of, pushing_differences, pushing_tables
from shmoo_mjx.evaluation.pushing_trials import KINDS, METHODS, draw_trials, kind_by_resistance
from shmoo_mjx.evaluation.registry import run_experiment
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult
from shmoo_mjx.learning.weights import untrained
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command


def test_trials_come_from_seeds_alone_and_are_unseen() -> None:
    trials = draw_trials(1_000_000, 3, 10)
    assert trials == draw_trials(1_000_000, 3, 10)
    assert len(trials) == 90
    assert len({t.name for t in trials}) == 90
    assert all(1_000_000 <= t.condition.seed < 1_001_000 for t in trials)
    others = draw_trials(1_001_000, 3, 10)
    assert not {t.condition.fingerprint() for t in trials} & {t.condition.fingerprint() for t in others}
    moved = draw_trials(1_000_000, 4, 10)
    assert [t.condition for t in moved] == [t.condition for t in trials]
    assert [t.robot_pose for t in moved] != [t.robot_pose for t in trials]


def test_every_object_can_be_pushed_before_and_after_its_change() -> None:
    trials = draw_trials(1_000_000, 0, 10)
    assert max(t.condition.resistance for t in trials) <= 40.0
    assert max(t.changed.resistance for t in trials) <= 40.0 + 0.1
    kinds = {t.change for t in trials}
    assert kinds == {"none", "mass", "brake"}
    for trial in trials:
        assert (trial.changed == trial.condition) == (trial.change == "none")
        if trial.change == "mass":
            assert trial.changed.payload > trial.condition.payload
        if trial.change == "brake":
            worse = np.array(trial.changed.rolling) > np.array(trial.condition.rolling)
            assert worse.sum() == 1


def test_demanding_objects_ask_for_adaptation_and_all_change_on_the_way() -> None:
    trials = draw_trials(1_000_000, 0, 7, stratum="demanding")
    drawn = draw_trials(1_000_000, 0, 10)
    assert len(trials) == 63
    assert not {t.name for t in trials} & {t.name for t in drawn}
    assert not {t.condition.seed for t in trials} & {t.condition.seed for t in drawn}
    assert all(1_000_000 <= t.condition.seed < 1_001_000 for t in trials)
    assert max(c.resistance for t in trials for c in (t.condition, t.changed)) <= 45.0 + 0.1
    assert all(t.change != "none" and t.changed != t.condition for t in trials)
    by_demand = {d: [t for t in trials if t.demand == d] for d in ("off_centre", "heavy", "floor", "brake")}
    assert all(by_demand.values())
    assert sum(len(of) for of in by_demand.values()) == len(trials)
    assert all(t.condition.resistance >= 25.0 for t in by_demand["heavy"])
    for trial in by_demand["off_centre"]:
        assert abs(trial.condition.payload_x) >= 0.24 * trial.condition.size[0]
        assert trial.condition.payload >= 0.69 * trial.condition.mass
    for trial in by_demand["brake"]:
        assert max(trial.condition.rolling) > 1.5 * np.median(trial.condition.rolling)
    # Behind its rear axle a load would tip the chair.
    assert all(t.condition.payload_x >= 0 for t in trials if t.family == "wheelchair")


def test_everything_leaves_no_object_out() -> None:
    trials = draw_trials(1_000_000, 0, 5, stratum="everything")
    assert len(trials) == 45
    assert {t.condition for t in trials} == {draw_condition(f, 1_000_200 + i) for f in FAMILIES for i in range(5)}
    assert all(t.changed == t.condition and t.change == "none" for t in trials)
    others = [t for s in ("movable", "demanding") for t in draw_trials(1_000_000, 0, 10, stratum=s)]
    assert not {t.name for t in trials} & {t.name for t in others}
    assert not {t.condition.seed for t in trials} & {t.condition.seed for t in others}
    kinds = {kind_by_resistance(t.condition): t.condition for t in trials}
    assert set(kinds) == set(KINDS)
    assert kinds["immovable"].resistance > 75.0 >= kinds["heavy"].resistance > 32.0 and any(kinds["locked"].locked)
    assert {kind_by_resistance(t.condition) for t in draw_trials(1_000_000, 0, 10)} == {"movable"}


def test_start_poses_lie_all_round_the_object() -> None:
    poses = np.array([t.robot_pose for t in draw_trials(1_000_000, 0, 10)])
    quadrants = set(np.floor(np.arctan2(poses[:, 1], poses[:, 0]) / (np.pi / 2)).astype(int).tolist())
    assert quadrants == {-2, -1, 0, 1}


def test_changing_the_scene_keeps_the_state_and_changes_the_motion() -> None:
    """A sliding box with a higher friction stops sooner, from the very state it had."""
    easy = draw_condition("box", 3, {"friction": 0.3})
    rough = draw_condition("box", 3, {"friction": 0.6})

    def slide(change: bool) -> tuple[float, float]:
        engine = MujocoEngine([build_scene([(easy, (2.0, 0.0, 0.0))])])
        world, _ = engine.step(engine.init(), command(1), 0.2)
        physics = world.physics.copy()
        nq = engine.scenes[0].model.nq
        physics[0, 1 + nq + engine.scenes[0].object_qvel[0]] = 1.0
        world = world._replace(physics=physics)
        if change:
            engine.change([build_scene([(rough, (0.0, 0.0, 0.0))])])
        assert engine.observe(world).object_pose[0, 0, 0] == pytest.approx(2.0, abs=0.01)
        world, seen = engine.step(world, command(1), 0.2)
        engine.close()
        return float(seen.object_pose[0, 0, 0]) - 2.0, float(seen.object_twist[0, 0, 0])

    (far, fast), (near, slow) = slide(False), slide(True)
    assert fast == pytest.approx(1 - 0.2 * 0.3 * 9.81, abs=0.06)
    assert near < far
    assert slow == pytest.approx(0.0, abs=0.06)


def test_a_scene_of_another_structure_is_refused() -> None:
    engine = MujocoEngine([build_scene([(draw_condition("box", 0), (2.0, 0.0, 0.0))])])
    with pytest.raises(ValueError, match="structure"):
        engine.change([build_scene([(draw_condition("cart", 0), (2.0, 0.0, 0.0))])])


def test_the_circle_holds_all_points_and_no_smaller_one_does() -> None:
    points = np.random.default_rng(0).normal(size=(30, 2))
    centre, radius = enclosing_circle(points)
    assert np.linalg.norm(points - centre, axis=1).max() == pytest.approx(radius, rel=1e-6)
    for shift in 0.02 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [0.7, 0.7], [-0.7, 0.7]]):
        assert np.linalg.norm(points - centre - shift, axis=1).max() > radius


def _row(method: str, trial: str, goal: int, offset: float, yaw: float = 5.0, **more: Any) -> dict[str, Any]:
    row = {
        "method": method, "trial": trial, "family": trial.split("-")[0], "goal": goal, "run": 0, "offset_m": offset,
        "yaw_error_deg": yaw, "success": offset <= 0.25 and yaw <= 20, "fell": False, "toppled": False, "time_s": 40.0,
        "pushes": 1, "worst_lean_rad": 0.1, "arm_margin_rad": 0.3, "final_x": 1.0 + offset, "final_y": 0.0,
        "change": "none", "object": "a box", "ended": "done", "stratum": "movable",
    }  # fmt: skip
    return row | more


def test_metrics_have_the_names_that_were_agreed() -> None:
    rows = [
        _row("ours", "box-goal1-00", 1, 0.05),
        _row("ours", "box-goal1-01", 1, 0.15, yaw=30.0),
        _row("ours", "cart-goal2-00", 2, 0.30, fell=True, worst_lean_rad=0.5),
        _row("frozen_prior", "box-goal1-00", 1, 0.5),
    ]
    m = metrics_of(rows)
    assert m["offset_goal1_m"] == pytest.approx(0.10)
    assert m["radius_goal1_m"] == pytest.approx(0.05, rel=1e-3)
    assert m["circle_goal1_m"] == pytest.approx(0.15)
    assert m["success_rate"] == pytest.approx(1 / 3)
    assert m["falls"] == 1
    assert m["worst_lean_rad"] == 0.5
    assert m["baseline_frozen_prior_offset_goal1_m"] == 0.5
    assert m["baseline_frozen_prior_success_rate"] == 0.0
    assert m["success_rate_movable"] == pytest.approx(1 / 3)


def test_differences_are_of_the_trials_that_both_ran() -> None:
    rows = []
    for i in range(8):
        rows.append(_row("ours", f"box-goal1-{i:02d}", 1, 0.05 + 0.002 * i))
        rows.append(_row("frozen_prior", f"box-goal1-{i:02d}", 1, 0.15 + 0.004 * i, change="mass"))
        rows.append(_row("oracle_coefficients", f"box-goal1-{i:02d}", 1, 0.01))
    rows.append(_row("ours", "cart-goal1-00", 1, 9.0))
    m = metrics_of(rows)
    assert m["difference_frozen_prior_offset_m"] == pytest.approx(-0.107)
    assert m["difference_frozen_prior_offset_m_low"] < -0.107 < m["difference_frozen_prior_offset_m_high"] < 0
    assert m["difference_frozen_prior_offset_m_pairs"] == 8
    assert m["difference_frozen_prior_box_offset_m"] == pytest.approx(-0.107)
    assert "difference_frozen_prior_cart_offset_m" not in m
    assert m["way_to_oracle"] == pytest.approx((0.164 - 0.057) / (0.164 - 0.01))
    about = {"config": {"methods": list(METHODS)}, "versions": {}, "paper": {}}
    result = ExperimentResult(experiment="pushing", seed=0, metrics=m, rows=rows, **about)
    table = pushing_differences(result)
    assert "-0.11 (" in table
    assert "**better**" in table
    assert "**worse**" in table


def test_everything_is_measured_by_itself() -> None:
    rows = [_row(m, "box-goal1-00", 1, offset) for m, offset in (("ours", 0.1), ("frozen_prior", 0.2))]
    chosen = metrics_of(rows)
    for i, kind in enumerate(["movable", "immovable", "locked", "immovable"]):
        more = {"stratum": "everything", "kind": kind}
        rows += [_row("ours", f"everything-cart-goal1-{i:02d}", 1, 0.1 + 0.3 * (kind == "immovable"), **more)]
        rows += [_row("frozen_prior", f"everything-cart-goal1-{i:02d}", 1, 0.4, **more)]
    m = metrics_of(rows)
    assert chosen.items() <= m.items()
    assert m["everything_success_rate"] == 0.5 and m["everything_success_rate_kind_immovable"] == 0.0
    assert m["everything_difference_frozen_prior_success"] == 0.5
    about = {"config": {"methods": ["ours", "frozen_prior"]}, "versions": {}, "paper": {}}
    tables = pushing_tables(ExperimentResult(experiment="pushing", seed=0, metrics=m, rows=rows, **about))
    everything = tables.split("## Objects as drawn, none left out")[1]
    assert "50 % objects of more than 75 N" in everything and "| Trials | 4 | 4 |" in everything
    assert "| Success rate | +0.50 (0 to 1; n = 4) |" in everything


def test_the_paper_pushes_with_its_own_weights_and_settings() -> None:
    pusher = pushing_trials._pusher("paper", untrained(), pose_push_config())
    assert isinstance(pusher, PushController) and pusher.weights.info == method_named("paper").load().info
    assert pusher.config == method_named("paper").pose_pushing


@pytest.mark.slow
def test_finished_trials_are_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    stops = [5]

    class Fake:
        def run(self, trial: Any, method: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
            if stops and len(asked) == stops[0]:
                stops.clear()
                raise KeyboardInterrupt
            asked.append(f"{method}-{trial.name}")
            way = np.linspace(trial.object_pose, trial.goal_pose, 5)
            row = _row(method, trial.name, trial.goal, 0.1, family=trial.family, stratum=trial.stratum)
            return row, {"object_pose": way}

    monkeypatch.setattr(pushing, "_runner", lambda *_: Fake())
    config = replace(pushing.EXPERIMENT.quick, workers=1)
    options = ExperimentOptions(out=tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_experiment("pushing", options, config)
    result = run_experiment("pushing", options, config)
    total = 18 * len(METHODS)
    assert len(asked) == total == len(set(asked))
    assert len(result.rows) == total
    assert result.metrics["success_rate"] == 1.0
    assert result.paper["offset_goal1_m"] == 0.067
    assert (tmp_path / "pushing" / "pushing.png").stat().st_size > 10_000
    run_experiment("pushing", options, config)
    assert len(asked) == total
    run_experiment("pushing", ExperimentOptions(out=tmp_path, seed=1), config)
    assert len(asked) == 2 * total


@pytest.mark.slow
@pytest.mark.parametrize("method", ["quasi_static", "ours"])
def test_a_trial_with_real_senses_stays_within_its_limits(method: str) -> None:
    from shmoo_mjx.base.assets import asset
    from shmoo_mjx.evaluation.pushing_trials import Runner
    from shmoo_mjx.learning.weights import load_weights

    trial = next(t for t in draw_trials(500_000, 0, 1) if t.family == "box" and t.goal == 1)
    weights = load_weights(asset("experiments/weights/demo.safetensors"))
    row, track = Runner(weights, 120.0).run(trial, method)
    assert not row["fell"]
    assert row["worst_lean_rad"] < 0.2
    assert row["arm_margin_rad"] > 0.0
    assert row["offset_m"] < 0.25
    assert len(track["t"]) == len(track["qpos"])


@pytest.mark.slow
def test_a_box_that_is_pushed_over_is_no_success() -> None:
    """0.46 m deep, 0.72 m high, with its load ahead of its centre, on a rough floor: it tips before it slides. With
    adaptation the robot can notice in time that it does not slide."""
    from shmoo_mjx.base.assets import asset
    from shmoo_mjx.evaluation.pushing_trials import Runner
    from shmoo_mjx.learning.weights import load_weights

    trial = next(
        t for t in draw_trials(1_111_000, 0, 1, goals=(2,), stratum="demanding") if t.name == "demanding-box-goal2-00"
    )
    rough = replace(trial, condition=replace(trial.condition, friction=0.9))
    row, _ = Runner(load_weights(asset("experiments/weights/demo.safetensors")), 60.0).run(rough, "frozen_prior")
    assert row["toppled"] and not row["success"] and not row["fell"]


def test_a_controller_of_ones_own_pushes_in_the_place_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from shmoo_mjx.evaluation.pushing_trials import Runner
    from shmoo_mjx.learning.weights import load_weights

    page = (Path(__file__).resolve().parents[2] / "docs/how_to/pusher.md").read_text()
    example = page.split("```python\n# my_pusher.py\n")[1].partition("```")[0]
    (tmp_path / "my_pusher.py").write_text(example)
    (tmp_path / "my_broken.py").write_text(
        "from my_pusher import LeansOn\n\n\nclass Broken(LeansOn):\n    step = None\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    trial = next(t for t in draw_trials(500_000, 0, 1) if t.family == "box" and t.goal == 1)
    runner = Runner(load_weights(), 14.0)
    row, track = runner.run(trial, "my_pusher:LeansOn")
    assert row["method"] == "my_pusher:LeansOn" and not row["fell"]
    assert np.hypot(*(track["object_pose"][-1] - track["object_pose"][0])[:2]) > 0.1
    with pytest.raises(ShmooError, match="pushing controller my_broken:Broken: TypeError"):
        runner.run(trial, "my_broken:Broken")
    with pytest.raises(ShmooError, match="has no class or function 'Nothing'"):
        runner.run(trial, "my_pusher:Nothing")
