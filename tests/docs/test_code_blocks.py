"""The code in the documentation runs: every Python block, every command's options, and the whole tutorial."""

from __future__ import annotations

import inspect
import os
import re
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import NamedTuple

import pytest
import tyro

from shmoo_mjx import cli
from shmoo_mjx.base.verbosity import with_verbosity

ROOT = Path(__file__).resolve().parents[2]
HOW_TO = "docs/how_to/"
PAGES = ["README.md", "CONTRIBUTING.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
PRINTS = {
    "README.md": "->",
    f"{HOW_TO}cost.md": "turned by",
    f"{HOW_TO}robot.md": "pushed away by",
    f"{HOW_TO}object.md": "pushed by",
    f"{HOW_TO}recording.md": "prior 32.7",
    f"{HOW_TO}learner.md": "variance unexplained",
    f"{HOW_TO}mppi.md": "of 1, cart at",
    f"{HOW_TO}daiml.md": "after 20 samples",
    f"{HOW_TO}ballbot.md": "lean",
    f"{HOW_TO}object_planner.md": "movable: True",
}
NEEDS = {"docs/gym.md": "gymnasium"}
LINES_OF_A_TASK = 32
LONG = (
    "README.md",
    *(f"{HOW_TO}{name}.md" for name in ("cost", "daiml", "learner", "mppi", "object_planner", "recording")),
)
"""Pages whose examples train, record or compile for half a minute."""
LONGEST = 130
"""Lines of a how-to page."""
READ = re.compile(r"(?:^|[ =])([\w./-]+\.(?:yaml|json|stl|csv|py|npz))\b|\b(my_\w+):\w+")
"""File that a command names, or module of a policy or pushing controller."""


class Block(NamedTuple):
    language: str
    text: str


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str) -> list[Block]:
    return [Block(*found) for found in FENCE.findall(text_of(page))]


def python_of(page: str) -> str:
    return "\n".join(block.text for block in blocks(page) if block.language == "python")


def commands(page: str) -> list[str]:
    """Every shmoo command of the page's shell blocks and indented blocks."""
    text = text_of(page).replace("\\\n", " ")
    fenced = [match[2] for match in FENCE.finditer(text) if match[1] == "bash"]
    lines = [line for block in fenced for line in block.splitlines()]
    lines += [line.strip() for line in FENCE.sub("", text).splitlines() if line.startswith("    ")]
    found = [re.search(r"(?:^|&& )(?:[A-Z_]+=\S+ )*(?:uv run )?(shmoo [^#>&|]+)", line) for line in lines]
    whole = [match[1].strip() for match in found if match and "..." not in match[1] and "COMMAND" not in match[1]]
    # A single capital stands for a number.
    return [re.sub(r" [A-Z](?= |$)", " 0", line) for line in whole]


WITH_PYTHON = [page for page in PAGES if python_of(page)]
WITH_COMMANDS = [page for page in PAGES if commands(page)]


def test_the_pages_are_found() -> None:
    how_to = {page for page in PAGES if page.startswith(HOW_TO)} - {f"{HOW_TO}index.md"}
    assert len(how_to) >= 12 and {"README.md", "docs/tutorial.md", "docs/gym.md", *how_to} <= set(WITH_PYTHON)
    assert {"README.md", "docs/tutorial.md", "docs/performance.md", "docs/sweeps.md"} <= set(WITH_COMMANDS)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.slow if page in LONG else ())
        for page in WITH_PYTHON
        if page != "docs/tutorial.md"
    ],
)
def test_the_pages_python_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if page in NEEDS:
        pytest.importorskip(NEEDS[page], reason=f"{page} needs {NEEDS[page]}, which is not installed")
    monkeypatch.chdir(tmp_path)
    # One after the other in one name space, as a reader would type them.
    exec(compile(python_of(page), page, "exec"), {"__name__": "example"})
    assert PRINTS.get(page, "") in capsys.readouterr().out


def test_a_whole_task_is_short() -> None:
    assert len([line for line in python_of(f"{HOW_TO}cost.md").splitlines() if line.strip()]) <= LINES_OF_A_TASK


@pytest.mark.parametrize("page", [page for page in PAGES if page.startswith(HOW_TO)])
def test_how_to_pages_are_short_and_name_files_that_exist(page: str) -> None:
    """Files that a page's commands read are shipped, or written by its code, its listings or an earlier command."""
    assert len(text_of(page).splitlines()) <= LONGEST
    written = set(re.findall(r"\"([\w./-]+\.\w+)\"|^# ([\w./-]+\.\w+)$", python_of(page), re.MULTILINE))
    there = {name for pair in written for name in pair}
    for line in commands(page):
        there.update(re.findall(r"--(?:out|json) (\S+)", line))
        for file, module in READ.findall(line):
            name = file or f"{module}.py"
            assert name in there or (ROOT / name).exists(), f"{page}: {line}"
        there |= {f"{stem}.json" for stem in re.findall(r"object add (\S+)\.\w+", line)}


@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_pages_commands_are_ones(page: str) -> None:
    received: list[str] = []

    def stand_in_for(name: str) -> object:
        def stand_in(*arguments: object, **options: object) -> int:
            received.append(name)
            return 0

        stand_in.__signature__ = inspect.signature(cli._COMMANDS[name])  # type: ignore[attr-defined]
        stand_in.__annotations__ = inspect.get_annotations(cli._COMMANDS[name], eval_str=True)
        return with_verbosity(stand_in)

    stand_ins = {name: stand_in_for(name) for name in cli._COMMANDS}
    for line in commands(page):
        arguments = shlex.split(line)[1:]
        if arguments != ["--help"]:
            try:
                tyro.extras.subcommand_cli_from_dict(stand_ins, prog="shmoo", args=arguments, console_outputs=False)
            except SystemExit:
                pytest.fail(f"{page}: {line}")
            assert received[-1] == arguments[0]


@pytest.mark.slow
def test_the_tutorial_from_start_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scripts = sysconfig.get_path("scripts")
    env = os.environ | {"PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"}
    names: dict[str, object] = {"__name__": "example"}
    ran = []
    for block in blocks("docs/tutorial.md"):
        ran.append(block.language)
        if block.language == "python":
            exec(compile(block.text, "docs/tutorial.md", "exec"), names)
        else:
            done = subprocess.run(
                ["bash", "-e", "-c", block.text], env=env, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, f"{block.text}\n{done.stdout}\n{done.stderr}"
    assert ran == ["bash", "bash", "python", "python", "bash", "python", *["python"] * 10]
    assert sys.executable.startswith(str(Path(scripts).parent))
