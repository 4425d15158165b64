"""`shmoo list`: every line says something to type that the command line takes."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from subprocess import CompletedProcess

import pytest

from shmoo_mjx import cli
from shmoo_mjx.evaluation.catalogue import KINDS, catalogue

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


def test_options_of_one_experiment_are_refused_for_another(shmoo: Shmoo) -> None:
    refused = shmoo("experiment", "pushing", "--runs", "3")
    assert refused.returncode == 2 and "--runs" in refused.stderr and "faults" in refused.stderr
