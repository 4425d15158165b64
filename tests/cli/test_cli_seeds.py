"""Every command takes the same seeds, refuses the same, and none reaches from unseen objects into training."""

from __future__ import annotations

import inspect
import re
import shlex
import sys
import typing
from pathlib import Path

import pytest
import yaml

from shmoo_mjx import cli
from shmoo_mjx.base import seeds
from shmoo_mjx.data.collect import SPLIT_SEEDS
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.plant.objects import draw_condition

BAD = ("-1", str(2**31), str(2**63), "1e30", "12345678901234567890", "9" * 6000, "1.0", "one", "1_000", "\u0663", "")
COMMANDS = {
    "scenarios": "scenarios make --out set.json --condition-seed",
    "demo": "demo --seed",
    "the end of a demo's range": "demo --seed 0..",
    "collect": "collect data --seed",
    "train": "train object data --seed",
    "push": "push box --seed",
    "view": "view box --no-window --seed",
    "experiment": "experiment object_model --seed",
    "objects of an experiment": "experiment object_model --condition-seed",
    "bench": "bench mppi --seed",
    "faults": "experiment faults --seed",
    "soak": "experiment soak --seed",
}


def run(words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and what stands on stderr."""
    monkeypatch.setattr(sys, "argv", ["shmoo", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = capsys.readouterr()
    assert said.out == ""
    return int(ended.value.code or 0), said.err


@pytest.mark.parametrize("seed", BAD, ids=lambda text: text[:20] or "empty")
@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_a_bad_seed_is_answered_with_one_sentence(
    command: str, seed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = shlex.split(command)
    code, said = run([*words[:-1], words[-1] + seed] if words[-1] == "0.." else [*words, seed], monkeypatch, capsys)
    option = next(word for word in words if word.endswith("seed"))
    assert code == 2 and re.fullmatch(rf"shmoo: {option} '.*' must be a whole number from 0 to \d+\.\n", said)
    assert len(said) < 160 and not list(tmp_path.iterdir())


def test_no_option_of_a_seed_was_forgotten() -> None:
    found = []
    for name, command in cli._COMMANDS.items():
        hints = typing.get_type_hints(command, include_extras=True)
        for parameter in inspect.signature(command).parameters:
            if "seed" in parameter:
                found.append(name)
                kind = seeds.ConditionSeed if parameter == "condition_seed" else seeds.Seed
                fine = hints[parameter] in (kind, kind | None, tuple[kind, ...])  # type: ignore[valid-type]
                assert fine or (name, hints[parameter]) == ("demo", seeds.Seeds), (name, parameter)
    assert set(found) == {command.split()[0] for command in COMMANDS.values()}


@pytest.mark.parametrize("command", ["navigate --scenario file.yaml", "view file.yaml", "sweep file.yaml"])
@pytest.mark.parametrize("field", ["seed", "object"])
@pytest.mark.parametrize("seed", [-1, 2**63, 10**30, 1e30])
def test_a_bad_seed_in_a_file_is_answered_with_one_sentence(
    command: str,
    field: str,
    seed: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    if command.startswith("sweep"):
        content = {"seed" if field == "seed" else "first_object": seed}
    else:
        box = {"family": "box", "pose": [3.0, 1.0, 0.0]}
        content = {"map": "room.yaml", "start": [1.0, 1.0, 0.0], "goal": [2.0, 1.0]}
        content |= {"seed": seed, "objects": [box]} if field == "seed" else {"objects": [box | {"seed": seed}]}
    (tmp_path / "file.yaml").write_text(yaml.safe_dump(content))
    code, said = run(command.split(), monkeypatch, capsys)
    assert code == 2 and said.startswith("shmoo: file.yaml") and said.count("\n") == 1
    assert ("first_object" in said) if command.startswith("sweep") and field == "object" else ("seed" in said)


@pytest.mark.parametrize("seed", [-1000, -1, seeds.MAX_CONDITION_SEED + 1])
def test_unseen_objects_are_never_those_of_training(
    seed: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = run(["experiment", "object_model", "--condition-seed", str(seed)], monkeypatch, capsys)
    assert code == 2 and said.startswith(f"shmoo: --condition-seed '{seed}' ")
    with pytest.raises(ShmooError, match="--condition-seed"):
        ExperimentOptions(condition_seed=seed)


def test_seeds_that_are_taken_lie_above_those_of_training() -> None:
    training = SPLIT_SEEDS["test"]
    assert ExperimentOptions().first_unseen == training
    last = ExperimentOptions(seed=seeds.MAX_SEED, condition_seed=seeds.MAX_CONDITION_SEED).first_unseen
    assert training < last and last + 999 <= seeds.MAX_SEED
    assert draw_condition("box", seeds.MAX_SEED).seed == seeds.MAX_SEED


@pytest.mark.parametrize(("option", "most"), [("train", 100_000), ("validation", 900_000)])
def test_training_does_not_grow_into_the_next_splits_seeds(
    option: str, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = run(["collect", str(tmp_path / "d"), f"--{option}", str(most + 1)], monkeypatch, capsys)
    assert code == 2 and f"{most} is the most" in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_recorded_drive_is_of_no_unseen_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["view", "box", "--seed", "1000000", "--record", str(tmp_path / "d")]
    code, said = run(words, monkeypatch, capsys)
    assert code == 2 and "999999" in said and said.count("\n") == 1


def test_the_largest_seed_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr("shmoo_mjx.run.demo.run_demo", lambda drawn, *_, **__: asked.append(drawn) or 0)
    for text in ("0", "2147483647", "0..2147483647"):
        assert cli.demo(seed=seeds.seeds_of(text)) == 0
    assert [(drawn[0], drawn[-1]) for drawn in asked] == [(0, 0), (2**31 - 1, 2**31 - 1), (0, 2**31 - 1)]
    with pytest.raises(ShmooError, match=r"0\.\.19"):
        seeds.seeds_of("3..2")
