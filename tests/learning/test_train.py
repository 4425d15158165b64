"""What ``shmoo train`` writes: the part that was trained, and what made it."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from shmoo_mjx.base.assets import PAPER_WEIGHTS, WEIGHTS, asset
from shmoo_mjx.data import store
from shmoo_mjx.data.collect import CollectConfig
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.dynamics.robot_model import RobotConfig
from shmoo_mjx.learning import daiml, robot_fit, train, training, weights
from shmoo_mjx.learning.train import train_part


def record(directory: Path, names: tuple[str, ...]) -> Path:
    """A data set of noise."""
    opened = store.create_or_open(directory, {"config": {"seed": 5}})
    shapes = {key: (2, 6, *tail) for key, tail in store.FIELDS.items()} | {"face": (2, 4), "size": (2,)}
    for name in names:
        rng = np.random.default_rng(ord(name))
        arrays = {key: rng.normal(size=shape) for key, shape in shapes.items()}
        store.write_condition(opened, name, arrays, {"family": "box", "seed": ord(name), "split": "train"})
    return directory


@pytest.fixture
def untaught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings that are over at once."""
    made = weights.untrained(seed=1)
    known = np.zeros_like(made.params.coefficients), made.prior_covariance, made.noise
    psi = daiml.ObjectFit(made.params.object, *known, 0.2, [], made.contact_prior, made.config.object)
    robot = robot_fit.RobotFit(made.params.robot, 0.1, np.zeros(5), [])
    monkeypatch.setattr(daiml, "train_object", lambda *_, **__: psi)
    monkeypatch.setattr(robot_fit, "train_robot", lambda *_, **__: robot)


def made_by(path: Path) -> dict[str, Any]:
    return weights.load_weights(path).info["made_by"]


def test_weights_carry_what_made_each_part(untaught: None, tmp_path: Path) -> None:
    data, out = record(tmp_path / "data", ("a", "b")), tmp_path / "w.safetensors"
    assert train_part("object", data, out, seed=3) == 0.2 and train_part("robot", data, out, seed=4) == 0.1
    found = made_by(out)
    assert set(found) == {"object", "robot"}
    psi, robot = found["object"], found["robot"]
    assert psi["command"] == "shmoo train object DATA --seed 3" and (psi["seed"], psi["score"]) == (3, 0.2)
    assert robot["command"] == "shmoo train robot DATA --seed 4" and (robot["seed"], robot["score"]) == (4, 0.1)
    assert psi["data"] == robot["data"] and psi["data"]["conditions"] == 2
    assert psi["data"]["sha256"] == store.fingerprint_of(data)
    assert psi["data"]["collected_with"] == {"config": {"seed": 5}}
    assert {"python", "jax", "mujoco", "shmoo-mjx"} <= psi["versions"].keys() and "jax" in psi["data"]["versions"]


@pytest.mark.parametrize(("file", "form"), [(WEIGHTS, ""), (PAPER_WEIGHTS, " --form paper")])
def test_the_shipped_weights_say_what_made_them(file: str, form: str) -> None:
    forms = {"robot": "", "object": form}
    for part, by in made_by(asset(file)).items():
        assert by["command"] == f"shmoo train {part} DATA --seed 0{forms[part]}" and by["data"]["conditions"] == 144
        assert by["data"]["collected_with"]["config"] == asdict(CollectConfig())
    # Both are trained on the same data.
    assert made_by(asset(file))["object"]["data"] == made_by(asset(WEIGHTS))["object"]["data"]
    robots = (weights.load_weights(asset(name)).params.robot for name in (file, WEIGHTS))
    assert jax.tree.all(jax.tree.map(np.array_equal, *robots))


def test_the_papers_form_is_trained_and_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def stop(part: str) -> Any:
        def instead(data: Path, checkpoints: Path, config: Any, progress: Any) -> Any:
            asked[part] = checkpoints.name, config
            raise KeyboardInterrupt

        return instead

    monkeypatch.setattr(daiml, "train_object", stop("object"))
    monkeypatch.setattr(robot_fit, "train_robot", stop("robot"))
    data = record(tmp_path / "data", ("a", "b"))
    for part in ("object", "robot"):
        with pytest.raises(KeyboardInterrupt):
            train_part(part, data, tmp_path / "w.safetensors", form="paper")
    assert asked["object"][0] == "object-paper" and asked["object"][1].object == ObjectConfig.paper()
    assert asked["robot"][0] == "robot-paper" and asked["robot"][1].robot == RobotConfig.paper()
    said = train.origin("object", data, 2, score=0.1, quick=True, form="paper")["command"]
    assert said == "shmoo train object DATA --seed 2 --form paper --quick"


def test_the_same_training_gives_the_same_file_wherever_it_runs(untaught: None, tmp_path: Path) -> None:
    files = [tmp_path / "x" / "w.safetensors", tmp_path / "y" / "v.safetensors"]
    for out, names in zip(files, (("a", "b"), ("b", "a")), strict=True):
        train_part("robot", record(out.parent / "data", names), out)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_other_data_has_another_hash(tmp_path: Path) -> None:
    first, more = record(tmp_path / "x", ("a", "b")), record(tmp_path / "y", ("a", "c"))
    assert store.fingerprint_of(first) != store.fingerprint_of(more)
    manifest = json.loads((first / "manifest.json").read_text())
    manifest["schema"]["config"]["seed"] = 6
    before = store.fingerprint_of(first)
    (first / "manifest.json").write_text(json.dumps(manifest))
    assert store.fingerprint_of(first) != before


@pytest.mark.slow
def test_the_short_form_says_so_and_leaves_an_interrupted_training_alone(
    synthetic_directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "w.safetensors"

    def stop(_: training.Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_part("robot", synthetic_directory, out, progress=stop)

    def kept() -> dict[Path, bytes]:
        folder = tmp_path / "w.safetensors.training" / "robot"
        return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    before, seen = kept(), list[training.Progress]()
    score = train_part("robot", synthetic_directory, out, progress=seen.append, quick=True)
    assert before and kept() == before
    assert seen[-1].epochs == train._QUICK["epochs"]
    assert made_by(out)["robot"]["command"] == "shmoo train robot DATA --seed 0 --quick"
    assert made_by(out)["robot"]["score"] == pytest.approx(score)


def test_the_short_form_takes_some_conditions_of_every_family() -> None:
    families = [
        (family, split, i) for family in "abc" for split, n in (("train", 40), ("validation", 8)) for i in range(n)
    ]
    conditions = [{"family": family, "split": split} for family, split, _ in families]
    few = train._few(store.Dataset([str(f) for f in families], conditions, [{} for _ in families], {}))
    for split, most in train._QUICK_CONDITIONS.items():
        chosen = few.split(split).conditions
        assert 0 < len(chosen) <= most and {c["family"] for c in chosen} == set("abc")
