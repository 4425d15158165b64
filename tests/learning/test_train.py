"""What `shmoo train` writes, in its short form too."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmoo_mjx.data import store
from shmoo_mjx.learning import train, training, weights


def test_the_short_form_says_so_and_leaves_an_interrupted_training_alone(
    synthetic_directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "w.safetensors"

    def stop(_: training.Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train.train_part("robot", synthetic_directory, out, progress=stop)
    (checkpoint,) = (tmp_path / "w.safetensors.training").rglob(training.CHECKPOINT)
    kept, seen = checkpoint.read_bytes(), list[training.Progress]()
    score = train.train_part("robot", synthetic_directory, out, progress=seen.append, quick=True)
    assert checkpoint.read_bytes() == kept
    assert seen[-1].epochs == train._QUICK["epochs"]
    assert weights.load_weights(out).info == {"robot_score": pytest.approx(score), "robot_quick": True}


def test_the_short_form_takes_some_conditions_of_every_family() -> None:
    families = [
        (family, split, i) for family in "abc" for split, n in (("train", 40), ("validation", 8)) for i in range(n)
    ]
    conditions = [{"family": family, "split": split} for family, split, _ in families]
    few = train._few(store.Dataset([str(f) for f in families], conditions, [{} for _ in families], {}))
    for split, most in train._QUICK_CONDITIONS.items():
        chosen = few.split(split).conditions
        assert 0 < len(chosen) <= most and {c["family"] for c in chosen} == set("abc")
