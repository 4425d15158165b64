"""Writes the command line reference, docs/cli.md and docs/cli_research.md: uv run python docs/cli_pages.py"""

from __future__ import annotations

import inspect
import re
import typing
from pathlib import Path
from typing import Any

import docstring_parser
from tyro.constructors import PrimitiveConstructorSpec

from shmoo_mjx import cli

DOCS = Path(__file__).parent
RESEARCH = ("scenarios", "collect", "train", "experiment", "sweep", "bench")
PAGES = {
    "cli.md": (
        "Command line: run and inspect",
        "Commands that run the robot and show what happens. The commands for data, training and experiments have "
        "[a page of their own](cli_research.md).",
        [name for name in cli._COMMANDS if name not in RESEARCH],
    ),
    "cli_research.md": (
        "Command line: train and measure",
        "Commands for data, training, experiments and benchmarks. The other commands are on [this page](cli.md).",
        list(RESEARCH),
    ),
}
COMMON = (
    "Type `shmoo --help` for all commands and `shmoo COMMAND --help` for one. Every command also takes `--quiet` "
    "(print only results and errors) and `--verbose` (print log lines to stderr instead of progress bars). A flag such "
    "as `--video` has the opposite `--no-video`. Bad input prints what is wrong and how to mend it, and ends with exit "
    "code 2."
)


def values(kind: Any) -> str:
    """What can be given for a parameter of this type: its choices, or the type of value."""
    if typing.get_origin(kind) is typing.Annotated:
        for extra in kind.__metadata__:
            if isinstance(extra, PrimitiveConstructorSpec):
                return str(extra.metavar).strip("{}").replace(",", ", ").replace("|", " or ")
        return values(kind.__origin__)
    if typing.get_origin(kind) is typing.Literal:
        return ", ".join(typing.get_args(kind))
    if typing.get_origin(kind) is tuple:
        inner = [part for part in typing.get_args(kind) if part is not ...]
        return " ".join(map(values, inner)) + (" ..." if len(inner) == 1 else "")
    parts = [part for part in typing.get_args(kind) if part is not type(None)]
    if parts:
        return " or ".join(map(values, parts))
    return {Path: "PATH", str: "TEXT", bool: "flag", int: "INT", float: "FLOAT"}[kind]


def default(parameter: inspect.Parameter) -> str:
    """Default value of a parameter, as it is typed."""
    value = parameter.default
    if value is inspect.Parameter.empty:
        return "required"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, range | tuple):
        return " ".join(map(str, value))
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def section(name: str) -> str:
    """Heading, description, example and table of options of one command."""
    command = cli._COMMANDS[name]
    doc = docstring_parser.parse(inspect.getdoc(command) or "")
    text = "\n\n".join(part for part in (doc.short_description, doc.long_description) if part)
    text = re.sub(r"^Example: (.+)$", r"    \1", text, flags=re.MULTILINE).replace("\n\n    ", "\n    ")
    text = re.sub(r"\n    ", "\n\n    ", text, count=1)
    lines = [f"## {name}", "", text, ""]
    hints = typing.get_type_hints(command, include_extras=True)
    described = {p.arg_name: " ".join((p.description or "").split()) for p in doc.params}
    parameters = inspect.signature(command).parameters
    if parameters:
        lines += ["| option | value | default | meaning |", "|---|---|---|---|"]
    for key, parameter in parameters.items():
        positional = parameter.kind is not inspect.Parameter.KEYWORD_ONLY
        option = key.upper() if positional else f"--{key.replace('_', '-')}"
        cells = (f"`{option}`", values(hints[key]), default(parameter), described[key])
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines).strip() + "\n"


def page(file: str) -> str:
    """Text of one of the two pages."""
    title, intro, names = PAGES[file]
    made = "<!-- Made by python docs/cli_pages.py; change the docstrings in shmoo_mjx/cli.py instead. -->"
    return "\n".join([made, "", f"# {title}", "", f"{intro} {COMMON}", "", *map(section, names)])


if __name__ == "__main__":
    for file in PAGES:
        (DOCS / file).write_text(page(file), encoding="utf-8")
