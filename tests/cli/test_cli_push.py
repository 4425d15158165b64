"""`shmoo push`: one object to a pose, through the real command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from shmoo_mjx import cli
from shmoo_mjx.run.replay import replay


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["shmoo", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["chair"], "no object family"),
        (["box", "--set", "mass"], "NAME=VALUE"),
        (["nope.json"], "shmoo: nope.json: there is no such object file"),
        (["box", "--set", "mass=heavy"], "finite number"),
        (["box", "--set", "size=0.5,0.5,0.6"], "a list such as [0.5,0.5,0.6]"),
        (["box", "--set", "masss=3"], "'masss' of the box is unknown"),
        (["box", "--set", "locked=[true"], "a list such as"),
        (["box", "--set", "mass=6", "control.rollouts=64"], "control.num_rollouts"),
        (["box", "--goal", "1,2"], "3 finite numbers"),
        (["box", "--goal", "20,0,0"], "'push_to' (20, 0): the box reaches off the map"),
        (["box", "--start", "0.1,0,0"], "stands where the robot is"),
    ],
)
def test_what_is_no_task_is_refused_in_one_sentence(
    words: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "push", *words, "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err
    assert told in said and said.count("\n") == 1, said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_box_is_brought_to_its_pose_told_of_and_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    words = [
        "--set",
        "mass=6",
        "friction=0.4",
        "control.num_rollouts=128",
        "--goal",
        "0.8,0.1,0.1",
        "--seed",
        "3",
        "--no-video",
    ]
    assert run(monkeypatch, "push", "box", *words, "--out", str(out)) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["push_to"] == [0.8, 0.1, 0.1] and result["goal_distance_m"] < 0.25
    assert result["config"]["pushing"]["control"]["num_rollouts"] == 128
    assert "brought the box to its goal" in (out / "report.html").read_text()
    assert replay(out) is None
    again = tmp_path / "again"
    words = ["--scenario", str(out / "scenario.yaml"), "--set", *result["settings"], "--no-video", "--out", str(again)]
    assert run(monkeypatch, "navigate", *words) == 0
    assert json.loads((again / "result.json").read_text())["transitions"] == result["transitions"]
