"""Every number that a command takes has a range, and one sentence for what lies outside."""

from __future__ import annotations

import inspect
import re
import sys
import typing
from pathlib import Path

import pytest

from shmoo_mjx import cli

BAD = ("-1", "-1000000", "nan", "inf", "-inf", "1e30", "9" * 6000, "one", "", "1_0", "\u0663", "0x10", "1,5")
POSITIONAL = {
    "map": "show map.yaml",
    "object": "add chair.stl",
    "scenarios": "make --out set.json",
    "experiment": "navigation",
    "bench": "mppi",
    "train": "object data",
    "collect": "data",
    "sweep": "push_mass_friction",
}


def numbers() -> dict[str, tuple[str, str]]:
    """Option to the words of a command that takes it, all but --seed and --condition-seed."""
    found = {}
    for name, command in cli._COMMANDS.items():
        hints = typing.get_type_hints(command, include_extras=True)
        for parameter in inspect.signature(command).parameters:
            parts = [hints[parameter], *typing.get_args(hints[parameter])]
            kinds = {typing.get_origin(p) or p for p in parts} - {type(None)}
            plain = {int, float} & {p for p in [hints[parameter], *_of_union(hints[parameter])] if isinstance(p, type)}
            assert not plain, f"{name} --{parameter} has no range; give it a type of shmoo_mjx.base.options"
            if {int, float} & kinds or any(set(typing.get_args(p)) & {int, float} for p in parts):
                option = f"--{parameter.replace('_', '-')}"
                if "seed" not in option:
                    found[f"{name} {option}"] = (name, option)
    return found


def _of_union(hint: typing.Any) -> tuple[typing.Any, ...]:
    return () if hasattr(hint, "__metadata__") else typing.get_args(hint)


def test_every_number_has_a_range() -> None:
    assert len(numbers()) >= 14


@pytest.mark.parametrize("bad", BAD, ids=lambda text: text[:12] or "empty")
@pytest.mark.parametrize(("name", "option"), numbers().values(), ids=numbers())
def test_a_number_outside_its_range_is_answered_with_one_sentence(
    name: str,
    option: str,
    bad: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    needed = ["--friction", "0.4"] if name == "object" and option != "--friction" else []
    code, said = answer([name, *POSITIONAL.get(name, "").split(), *needed, option, bad], monkeypatch, capsys)
    assert code == 2 and re.fullmatch(rf"shmoo: {option} '.*' must be a (whole )?number from .+ to .+\.\n", said), said
    assert len(said) < 160 and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("typed", "expected"),
    [("dmo", "did you mean demo?"), ("experimnt", "did you mean experiment?"), ("xyz", "choose from demo, navigate")],
)
def test_a_command_that_is_not_there_gets_a_suggestion(
    typed: str, expected: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = answer([typed], monkeypatch, capsys)
    assert code == 2 and said.startswith(f"shmoo: there is no command '{typed}'; {expected}")


def test_the_version_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["shmoo", "--version"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0 and re.fullmatch(r"shmoo_mjx \d+\.\d+\.\d+\n", capsys.readouterr().out)


def answer(words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and what stands on stderr."""
    monkeypatch.setattr(sys, "argv", ["shmoo", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = capsys.readouterr()
    assert said.out == ""
    return int(ended.value.code or 0), said.err
