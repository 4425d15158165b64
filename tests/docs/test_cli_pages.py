"""The command line reference agrees with the commands."""

from __future__ import annotations

import importlib.util
import typing
from pathlib import Path

import pytest

from shmoo_mjx import cli
from shmoo_mjx.base import options

DOCS = Path(__file__).resolve().parents[2] / "docs"
_spec = importlib.util.spec_from_file_location("cli_pages", DOCS / "cli_pages.py")
assert _spec and _spec.loader
pages = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(pages)


@pytest.mark.parametrize("file", pages.PAGES)
def test_the_page_is_up_to_date(file: str) -> None:
    assert (DOCS / file).read_text(encoding="utf-8") == pages.page(file), "run python docs/cli_pages.py"


def test_every_command_stands_on_one_page() -> None:
    assert sorted(name for *_, names in pages.PAGES.values() for name in names) == sorted(cli._COMMANDS)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (options.Senses, "real, perfect"),
        (options.Seconds | None, "FLOAT"),
        (options.ScenariosOrSet, "INT or FILE"),
        (typing.Literal["y", "z"], "y, z"),
        (tuple[str, ...], "TEXT ..."),
        (tuple[options.Side, options.Side] | None, "FLOAT FLOAT"),
    ],
)
def test_types_are_shown_as_what_can_be_typed(kind: object, text: str) -> None:
    assert pages.values(kind) == text
