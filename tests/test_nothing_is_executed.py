"""Reading a file never runs what is in it: pickles, arrays of pickled objects and YAML tags in the place of every file
that the program reads."""

from __future__ import annotations

import io
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import shmoo_mjx
from shmoo_mjx.data import store
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import read_result
from shmoo_mjx.evaluation.scenario_set import open_set
from shmoo_mjx.learning.checkpoints import Checkpoints
from shmoo_mjx.learning.serialisation import read_notes
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.planning.maps import OccupancyGrid, load_map, save_map
from shmoo_mjx.planning.scenario import load_scenario
from shmoo_mjx.plant.mesh import add_object
from shmoo_mjx.plant.object_file import read_object
from shmoo_mjx.report.trace import load_result, load_trace
from shmoo_mjx.run.custom_log import read_log
from shmoo_mjx.run.recording import load_recording
from shmoo_mjx.sweep.config import load_sweep


class Harm:
    """Leaves a file behind where it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("executed"),)


def payloads() -> dict[str, bytes]:
    """Files that execute something in a reader that lets them."""
    objects, single = io.BytesIO(), io.BytesIO()
    np.savez(objects, t=np.array([Harm()], dtype=object))
    np.save(single, np.array([Harm()], dtype=object), allow_pickle=True)
    tag = b"map: !!python/object/apply:os.system ['touch executed']\n"
    return {"pickle": pickle.dumps(Harm()), "npz": objects.getvalue(), "npy": single.getvalue(), "yaml": tag}


def a_map(image: Path) -> None:
    save_map(OccupancyGrid(np.zeros((20, 20), np.int8), 0.05), Path("room.yaml"))
    named = yaml.safe_load(Path("room.yaml").read_text())["image"]
    image.replace(named)
    load_map(Path("room.yaml"))


def a_recording(file: Path) -> None:
    opened = store.create_or_open("data", {})
    condition = {"family": "box", "seed": 0, "split": "train"}
    file.rename(Path("data") / "box-0.safetensors")
    store.adopt(opened, "box-0", condition)
    raise ShmooError("it is not taken up")


def a_training_state(file: Path) -> None:
    """In the place of every file of a checkpoint."""
    Checkpoints(Path("kept"), "x").save(1, {"a": np.zeros(3)}, {})
    for part in [path for path in Path("kept").rglob("*") if path.is_file()]:
        part.write_bytes(file.read_bytes())
    Checkpoints(Path("kept"), "x").load({"a": np.zeros(3)})


def a_manifest(file: Path) -> None:
    Path("data").mkdir()
    file.rename(Path("data") / store.MANIFEST)
    store.read("data")


READERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "scenario": ("f.yaml", load_scenario),
    "map": ("f.yaml", load_map),
    "map's image": ("f.png", a_map),
    "sweep": ("f.yaml", load_sweep),
    "scenario set": ("f.json", lambda file: open_set(file, Path("set"))),
    "object file": ("f.json", read_object),
    "mesh": ("f.obj", lambda file: add_object(file, 4.0, 0.4)),
    "binary mesh": ("f.stl", lambda file: add_object(file, 4.0, 0.4)),
    "MJCF": ("f.xml", lambda file: add_object(file, 4.0, 0.4)),
    "log": ("f.csv", read_log),
    "Parquet log": ("f.parquet", read_log),
    "weights": ("f.safetensors", load_weights),
    "notes of weights": ("f.safetensors", read_notes),
    "training state": ("f.training", a_training_state),
    "recording": ("f.safetensors", a_recording),
    "data set": ("f.json", a_manifest),
    "result of a run": ("result.json", load_result),
    "trace of a run": ("trace.npz", load_trace),
    "recorded run": ("recorded.npz", load_recording),
    "result of an experiment": ("f.json", read_result),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("payload", payloads())
def test_nothing_is_executed(reader: str, payload: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name, read = READERS[reader]
    Path(name).write_bytes(payloads()[payload])
    with pytest.raises(ShmooError):
        read(Path(name))
    assert not Path("executed").exists()


def test_the_payload_would_execute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.load(io.BytesIO(payloads()["npz"]), allow_pickle=True)["t"]
    assert Path("executed").exists()


def test_no_module_reads_in_a_way_that_executes() -> None:
    unsafe = re.compile(r"import pickle|allow_pickle=True|yaml\.(unsafe_|full_)load|(?<![.\w])(eval|exec)\(|joblib")
    package = Path(shmoo_mjx.__file__).parent
    found = {p.name: unsafe.findall(p.read_text()) for p in package.rglob("*.py")}
    assert not {name: hits for name, hits in found.items() if hits}
