"""What all commands have in common: an example that parses, --quiet, --verbose, completion, and a quick start."""

from __future__ import annotations

import contextlib
import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import tyro

from shmoo_mjx import cli
from shmoo_mjx.base import progress
from shmoo_mjx.base.verbosity import LOG, with_verbosity

HEAVY = {"jax", "mujoco", "numpy", "scipy", "shapely", "matplotlib", "pydantic", "yaml", "rich", "gymnasium", "PIL"}


@pytest.fixture(autouse=True)
def quietness_is_undone() -> object:
    level, propagate = LOG.level, LOG.propagate
    yield
    LOG.setLevel(level)
    LOG.propagate = propagate
    LOG.handlers.clear()


def run(arguments: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["shmoo", *shlex.split(arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0)


@pytest.mark.parametrize("name", cli._COMMANDS)
def test_every_commands_help_has_an_example_that_parses(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(f"{name} --help", monkeypatch) == 0
    shown = capsys.readouterr().out
    assert "--quiet" in shown and "--verbose" in shown
    examples = re.findall(rf"Example: shmoo ({name}\b.*)", shown)
    assert examples
    received = []

    def stand_in(*arguments: object, **options: object) -> int:
        received.append((arguments, options))
        return 0

    command = cli._COMMANDS[name]
    stand_in.__signature__ = inspect.signature(command)  # type: ignore[attr-defined]
    stand_in.__annotations__ = inspect.get_annotations(command, eval_str=True)
    commands = {name: with_verbosity(stand_in), "other": with_verbosity(cli.doctor)}
    for example in examples:
        arguments = shlex.split(example.partition(" > ")[0])
        assert tyro.extras.subcommand_cli_from_dict(commands, prog="shmoo", args=arguments) == 0
    assert len(received) == len(examples)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.suppress(SystemExit):
        cli._run(["completion", shell])
    script = capsys.readouterr().out
    assert all(name in script for name in cli._COMMANDS)
    assert "peers-python" in script and "verbose" in script


def work(monkeypatch: pytest.MonkeyPatch, options: str) -> None:
    """A command that reports two stages and a result."""

    def job() -> int:
        with progress.stages() as report:
            report("reading", 0.0)
            report("reading", 0.1)
            report("counting 3", 0.5)
            report("counting 4", 0.6)
        print("42")
        return 0

    monkeypatch.setitem(cli._COMMANDS, "doctor", job)
    assert run(f"doctor {options}", monkeypatch) == 0


def test_quiet_leaves_the_result_alone(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    work(monkeypatch, "--quiet")
    said = capfd.readouterr()
    assert said.out == "42\n" and said.err == ""


def test_without_options_there_is_a_bar(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    work(monkeypatch, "")
    said = capfd.readouterr()
    assert said.out == "42\n" and "left" in said.err


def test_verbose_is_a_log_with_times(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    work(monkeypatch, "--verbose")
    said = capfd.readouterr()
    lines = said.err.splitlines()
    assert said.out == "42\n"
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d ", line) for line in lines)
    told = [line[20:] for line in lines]
    assert told[0].startswith("shmoo ") and told[0].endswith("doctor --verbose")
    # The same stage with other numbers is not said again at once.
    assert told[1] == "reading: 0 %" and told[2].startswith("counting 3: 50 %, about 0 s left")
    assert told[3].startswith("took ") and told[3].endswith("exit code 0") and len(told) == 4


def test_both_at_once_are_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("doctor --quiet --verbose", monkeypatch) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, shmoo_mjx.cli; print(*sorted({m.partition('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not HEAVY & set(done.stdout.split())


def test_a_reader_that_leaves_is_no_error(tmp_path: Path) -> None:
    code = "from shmoo_mjx.cli import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "completion", "bash"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout and process.stderr
        process.stdout.close()
        assert process.stderr.read() == b""


@pytest.mark.parametrize(
    "command", ["demo", "navigate --start 1,1,0 --goal 2,2", "experiment pushing", "sweep push_mass_friction"]
)
def test_unknown_senses_are_refused_in_one_sentence(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(f"{command} --senses keen", monkeypatch) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "'keen'" in said and "real or perfect" in said
