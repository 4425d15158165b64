"""Full disks, folders that another process keeps, and machines without a home or with the C locale."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx import cli
from shmoo_mjx.base import files
from shmoo_mjx.base.files import claimed
from shmoo_mjx.planning.maps import OccupancyGrid, save_map

SHMOO = str(Path(sys.executable).with_name("shmoo"))
SWEEP = "worlds: 2\ncontrollers: {plain: {kind: quasi_static}}\n"
KEPT = {
    "demo": ("demo --quick --out OUT", "demo-0"),
    "collect": ("collect OUT", ""),
    "train": ("train robot data --out OUT/w.safetensors", "w.safetensors.training"),
    "experiment": ("experiment object_planner --quick --out OUT", "object_planner"),
    "sweep": ("sweep sweep.yaml --out OUT", ""),
    "faults": ("experiment faults --runs 1 --out OUT", "faults"),
    "soak": ("experiment soak --minutes 1 --out OUT", "soak"),
}
"""Commands, and the folder below OUT that they keep to themselves."""


def said(words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and what stands on stderr."""
    monkeypatch.setattr(sys, "argv", ["shmoo", *words])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return int(ended.value.code or 0), capsys.readouterr().err


def room(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    save_map(OccupancyGrid(np.zeros((60, 100), np.int8), 0.05), folder / "room.yaml")
    return folder / "room.yaml"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS])
def test_what_can_not_be_written_is_named_with_a_remedy_and_leaves_nothing(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = room(tmp_path)
    before = {p.name for p in tmp_path.iterdir()}

    def full(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(files.os, "fsync", full)
    code, text = said(["map", "show", str(path), "--out", str(tmp_path / "map.png")], monkeypatch, capsys)
    remedy = "make room" if number in (errno.ENOSPC, errno.EDQUOT) else "choose a place that can be read and written"
    assert code == 2 and text.startswith(f"shmoo: {tmp_path / 'map.png'}: {os.strerror(number)}; {remedy}")
    assert text.count("\n") == 1 and {p.name for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize("name", KEPT)
def test_of_two_processes_in_one_folder_the_second_is_turned_away(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    words, kept = KEPT[name]
    folder = tmp_path / "out" / kept
    with claimed(folder):
        code, text = said(words.replace("OUT", str(tmp_path / "out")).split(), monkeypatch, capsys)
    lines = text.splitlines()
    assert code == 2 and lines[-1] == (
        f"shmoo: {folder}: another process writes there; wait for it, or name another folder."
    )


@pytest.mark.slow
@pytest.mark.parametrize("home", [None, "/proc/none"])
def test_no_home_and_the_c_locale_do_no_harm(home: str | None, tmp_path: Path) -> None:
    place = room(tmp_path / "Möbel 桌子")
    environment = {k: v for k, v in os.environ.items() if k not in ("HOME", "XDG_CACHE_HOME", "LANG")}
    environment |= {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"} | ({"HOME": home} if home else {})

    def show(given: Path) -> subprocess.CompletedProcess[bytes]:
        command = [SHMOO, "map", "show", str(given), "--out", str(place.with_name("ü.png"))]
        return subprocess.run(command, env=environment, capture_output=True, check=False)

    done = show(place)
    assert done.returncode == 0 and b"Traceback" not in done.stderr and place.with_name("ü.png").is_file()
    done = show(place.with_name("nothing.yaml"))
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"there is no such map file" in done.stderr
