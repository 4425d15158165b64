"""Files are there whole or not at all, and what was not finished does not stay."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from shmoo_mjx.base import files
from shmoo_mjx.errors import ShmooError


def test_a_file_is_replaced_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    files.write_whole(path, b"old")

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        files.write_whole(path, b"new")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    stays = {"a.json", "a.json.tmp", "a.json.old.tmp", f"b.json.{dead.pid}.tmp", f"a.json.{os.getppid()}.tmp"}
    for name in (*stays, f"a.json.{dead.pid}.tmp", f"a.json.{10**30}.tmp"):
        (tmp_path / name).touch()
    files.write_whole(tmp_path / "a.json", b"")
    assert {path.name for path in tmp_path.iterdir()} == stays


def test_what_could_not_be_written_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.json").touch()
    with pytest.raises(OSError) as error:
        files.write_whole(tmp_path / "a.json" / "b.json", b"new")
    assert error.value.filename == str(tmp_path / "a.json" / "b.json") and error.value.strerror
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize("path", [".", "", "/"])
def test_a_folder_is_no_output_file(path: str) -> None:
    with pytest.raises(ShmooError, match="is a folder"):
        files.write_whole(path, b"new")


def test_a_folder_that_another_process_keeps_is_refused_and_free_again_once_that_is_gone(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "a"
    code = "import sys\nfrom shmoo_mjx.base.files import claimed\n"
    code += f"with claimed({str(folder)!r}):\n    print('kept', flush=True)\n    sys.stdin.read()"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "kept\n"
        with pytest.raises(ShmooError, match="another process writes there"), files.claimed(folder):
            pass
        with files.claimed(folder.with_name("b")):
            pass
        assert [path.name for path in folder.parent.iterdir()] == ["a"]
        other.kill()
    for _ in range(2):
        with files.claimed(folder):
            assert not list(folder.iterdir())
