"""No file that is read, and none of another kind, is ever replaced; one's own earlier output is."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from shmoo_mjx.base import guard
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.guard import check_folder, check_output, kind_of, protected
from shmoo_mjx.base.npz import write_arrays
from shmoo_mjx.errors import ShmooError


def png() -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(buffer, format="png")
    return buffer.getvalue()


CONTENTS = {
    "picture.png": (png(), guard.PNG),
    "notes.txt": ("Möbel\n".encode(), guard.TEXT),
    "page.html": (b"<!DOCTYPE html>\n<p>", guard.HTML),
    "film.mp4": (b"\0\0\0\x20ftypisom" + bytes(20), guard.FILM),
    "table.parquet": (b"PAR1 and so on", guard.TABLE),
    "map.yaml": (b"# a map\nimage: a.png\nresolution: 0.05\n", guard.MAP),
    "scene.yml": (b"map: a.yaml\nstart: [1, 1, 0]\n", guard.SCENARIO),
    "other.yaml": (b"services: {}\n", "a YAML file"),
    "run.json": (json.dumps({"name": "a", "outcome": "success"}).encode(), guard.RUN),
    "log.json": (json.dumps({"outcome": "log"}).encode(), guard.RECORDING),
    "result.json": (json.dumps({"experiment": "pushing", "config": {"outcome": 1}}).encode(), guard.EXPERIMENT),
    "set.json": (json.dumps({"format": "", "scenarios": []}).encode(), guard.SCENARIO_SET),
    "package.json": (b'{"name": "mine"}', "a JSON file"),
    "half.json": (b'{"name": "mi', guard.TEXT),
    "mesh.stl": (b"solid\0\1\2\3", guard.BINARY),
}


@pytest.mark.parametrize("name", CONTENTS)
def test_kinds_are_told_by_content(name: str, tmp_path: Path) -> None:
    content, kind = CONTENTS[name]
    (tmp_path / name).write_bytes(content)
    assert kind_of(tmp_path / name) == kind


def test_weights_and_arrays_are_told_too(tmp_path: Path) -> None:
    assert kind_of(asset(WEIGHTS)) == guard.WEIGHTS
    assert kind_of(write_arrays(tmp_path / "trace.npz", {"t": np.zeros(3)})) == guard.ARRAYS


@pytest.mark.parametrize("there", CONTENTS)
def test_only_the_same_kind_is_replaced(there: str, tmp_path: Path) -> None:
    path, (old, kind) = tmp_path / there, CONTENTS[there]
    for content, _ in CONTENTS.values():
        path.write_bytes(content)
        same = kind_of(path) == kind  # of YAML the ending of the name decides too
        path.write_bytes(old)
        if same:
            assert write_whole(path, content).read_bytes() == content
        else:
            with pytest.raises(ShmooError, match="would replace") as refused:
                write_whole(path, content)
            assert str(refused.value).startswith(f"{path}: ") and path.read_bytes() == old
        assert [p.name for p in tmp_path.iterdir()] == [there]


def test_an_empty_file_is_of_no_kind(tmp_path: Path) -> None:
    (tmp_path / "new").touch()
    assert write_whole(tmp_path / "new", png()).stat().st_size


LINKS: dict[str, Callable[[Path, Path], None]] = {
    "the same name": lambda link, file: None,
    "a symbolic link": lambda link, file: link.symlink_to(file.name),
    "a hard link": lambda link, file: link.hardlink_to(file),
    "a linked folder": lambda link, file: link.parent.joinpath("folder").symlink_to(file.parent),
}


@pytest.mark.parametrize("how", LINKS)
def test_an_input_is_not_replaced_under_any_name(how: str, tmp_path: Path) -> None:
    file = tmp_path / "map.png"
    file.write_bytes(png())
    LINKS[how](tmp_path / "other.png", file)
    name = {"the same name": "map.png", "a linked folder": "folder/map.png"}.get(how, "other.png")
    with protected([file]), pytest.raises(ShmooError, match="input of this command"):
        write_whole(tmp_path / name, png())
    assert file.read_bytes() == png()
    write_whole(tmp_path / name, png())


def test_protection_nests_and_ends(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    for path in (one, two):
        path.touch()
    with protected([one]):
        with protected([two, tmp_path / "not there"]):
            for path in (one, two):
                with pytest.raises(ShmooError):
                    check_output(path)
        check_output(two)
        with pytest.raises(ShmooError):
            check_output(one)
    check_output(one)


def test_a_folder_without_the_mark_of_an_earlier_output_is_somebody_elses(tmp_path: Path) -> None:
    files = {"trace.npz": guard.ARRAYS, "map.yaml": guard.MAP}
    check_folder(tmp_path / "absent", files, "trace.npz")
    (tmp_path / "readme.txt").write_text("of no interest")
    check_folder(tmp_path, files, "trace.npz")
    (tmp_path / "map.yaml").write_text("image: a.png\n")
    with pytest.raises(ShmooError, match=r"map\.yaml: was not written by an earlier run"):
        check_folder(tmp_path, files, "trace.npz")
    write_arrays(tmp_path / "trace.npz", {"t": np.zeros(3)})
    check_folder(tmp_path, files, "trace.npz")
    with pytest.raises(ShmooError, match=r"readme\.txt: is a file"):
        check_folder(tmp_path / "readme.txt", files, "trace.npz")
