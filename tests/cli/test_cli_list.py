"""`shmoo list`: every line says something to type that the command line takes."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from subprocess import CompletedProcess

import pytest

from shmoo_mjx import cli
from shmoo_mjx.evaluation.catalogue import KINDS, catalogue
from shmoo_mjx.evaluation.registry import check_options

Shmoo = Callable[..., CompletedProcess[str]]


@pytest.mark.parametrize("kind", KINDS)
def test_every_item_says_what_to_type(kind: str, shmoo: Shmoo) -> None:
    shown = shmoo("list", kind)
    items = catalogue(kind)
    assert shown.returncode == 0 and items and len(shown.stdout.splitlines()) == len(items)
    for item in items:
        program, command, *_ = shlex.split(item.command)
        assert program == "shmoo" and command in cli._COMMANDS
        assert item.name in shown.stdout and item.command in shown.stdout


def test_the_whole_list_names_each_kind(shmoo: Shmoo) -> None:
    shown = shmoo("list").stdout
    assert all(f"\n{kind}:" in f"\n{shown}" for kind in KINDS if kind != "settings")
    assert "shmoo list settings" in shown


@pytest.mark.parametrize("old", ["faults", "soak"])
def test_who_types_an_old_name_is_told_the_new_one(old: str, shmoo: Shmoo) -> None:
    refused = shmoo(old, "--seed", "900")
    assert refused.returncode == 2 and f"shmoo experiment {old}" in refused.stderr
    assert refused.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "user"),
    [
        ("pushing --runs 3", "faults"),
        ("all --minutes 3", "soak"),
        ("faults --maps maps", "navigation"),
        ("pushing --scenarios 3", "navigation"),
        ("object_planner --policies ours", "pushing"),
        ("navigation --data data", "object_model"),
        ("object_model --weights w.safetensors", "estimate"),
        ("faults --senses perfect", "outcomes"),
        ("real_pushing --pushes pushes", "all"),
    ],
)
def test_options_of_one_experiment_are_refused_for_another(words: str, user: str, shmoo: Shmoo) -> None:
    refused = shmoo("experiment", *words.split())
    option = words.split()[1]
    assert refused.returncode == 2 and refused.stderr.startswith(f"shmoo: {option} is for shmoo experiment ")
    assert user in refused.stderr and refused.stderr.count("\n") == 1


def test_all_takes_what_its_experiments_take() -> None:
    check_options("all", ["data", "maps", "scenarios", "policies", "pushes"])
