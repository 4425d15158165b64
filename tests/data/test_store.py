"""Data sets on disk: whole, resumable, and honest about damage."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.base import files
from shmoo_mjx.data import store
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2

CONDITION = {"family": "box", "seed": 3, "split": "train"}


def recording(seed: int = 0, episodes: int = 2, samples: int = 5) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    arrays = {k: rng.normal(size=(episodes, samples, *tail)) for k, tail in store.FIELDS.items()}
    arrays["contact"] = arrays["contact"] > 0
    return arrays | {"face": rng.normal(size=(episodes, 4)), "size": rng.uniform(0.2, 0.6, episodes)}


def test_round_trip_and_splits(tmp_path: Path) -> None:
    opened = store.create_or_open(tmp_path / "d", {"seed": 1})
    arrays = recording()
    store.write_condition(opened, "box-3", arrays, CONDITION)
    store.write_condition(opened, "box-4", recording(1), CONDITION | {"split": "test"})
    found = store.read(tmp_path / "d")
    assert found.names == ["box-3", "box-4"] and found.schema == {"seed": 1}
    np.testing.assert_allclose(found.arrays[0]["u"], arrays["u"], rtol=1e-6)
    assert found.arrays[0]["u"].dtype == np.float32 and found.arrays[0]["contact"].dtype == bool
    assert found.split("test").names == ["box-4"]
    assert store.read(tmp_path / "d", splits=("train",)).names == ["box-3"]


def test_resume_skips_what_is_whole(tmp_path: Path) -> None:
    opened = store.create_or_open(tmp_path, {"seed": 1})
    store.write_condition(opened, "a", recording(), CONDITION)
    again = store.create_or_open(tmp_path, {"seed": 1})
    assert again.has("a") and not again.has("b")
    path = tmp_path / "a.safetensors"
    path.write_bytes(path.read_bytes()[:-4])
    assert not again.has("a")
    with pytest.raises(ShmooError, match="schema"):
        store.create_or_open(tmp_path, {"seed": 2})


def test_damage_is_named(tmp_path: Path) -> None:
    opened = store.create_or_open(tmp_path, {})
    store.write_condition(opened, "a", recording(), CONDITION)
    path = tmp_path / "a.safetensors"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(ShmooError, match=r"a\.safetensors.*damaged"):
        store.read(tmp_path)
    path.unlink()
    with pytest.raises(ShmooError, match=r"a\.safetensors.*missing"):
        store.read(tmp_path)
    (tmp_path / "manifest.json").write_text('{"schema_version": 1')
    with pytest.raises(ShmooError, match=r"manifest\.json.*damaged"):
        store.read(tmp_path)
    with pytest.raises(ShmooError, match="no data set"):
        store.read(tmp_path / "elsewhere")


def test_an_interrupted_write_leaves_no_condition(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = store.create_or_open(tmp_path, {})

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        store.write_condition(opened, "a", recording(), CONDITION)
    monkeypatch.undo()
    again = store.create_or_open(tmp_path, {})
    assert not again.has("a") and not (tmp_path / "a.safetensors").exists()
    assert json.loads((tmp_path / "manifest.json").read_text())["conditions"] == {}


@pytest.mark.parametrize("name", ["../a", "/etc/a", "sub/a", "a"])
@pytest.mark.parametrize("file", ["../a.safetensors", "/etc/passwd", "other.safetensors", 3, None])
def test_a_manifest_names_only_files_in_its_folder(name: str, file: object, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    store.write_condition(store.create_or_open(folder, {}), "a", recording(), CONDITION)
    (tmp_path / "a.safetensors").write_bytes((folder / "a.safetensors").read_bytes())
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["conditions"] = {name: manifest["conditions"]["a"] | {"file": file}}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ShmooError, match=r"it must be NAME\.safetensors"):
        store.read(folder)


@pytest.mark.parametrize("field", ["schema", "conditions", "versions", "file", "sha256", "condition"])
@pytest.mark.parametrize("value", [None, 3, "x", []])
def test_a_manifest_with_anything_in_a_fields_place_is_refused(field: str, value: object, tmp_path: Path) -> None:
    store.write_condition(store.create_or_open(tmp_path, {}), "a", recording(), CONDITION)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    (manifest if field in manifest else manifest["conditions"]["a"])[field] = value
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ShmooError, match=r"manifest\.json|a\.safetensors|condition 'a'"):
        store.read(tmp_path)


def cut_before_the_manifest(directory: Path, schema: dict[str, int]) -> None:
    """What `write_condition` leaves when it is killed between the file of "a" and the manifest that names it."""
    store.write_condition(store.create_or_open(directory, schema), "a", recording(), CONDITION)
    (directory / "manifest.json").unlink()


def test_a_whole_file_that_was_not_named_yet_is_adopted(tmp_path: Path) -> None:
    cut_before_the_manifest(tmp_path, {"seed": 1})
    written = (tmp_path / "a.safetensors").stat().st_mtime_ns
    opened = store.create_or_open(tmp_path, {"seed": 1})
    assert store.adopt(opened, "a", CONDITION) and opened.has("a")
    assert store.read(tmp_path).names == ["a"] and (tmp_path / "a.safetensors").stat().st_mtime_ns == written
    assert not store.adopt(opened, "a", CONDITION) and not store.adopt(opened, "b", CONDITION)


def test_a_full_disk_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = store.create_or_open(tmp_path, {"seed": 1})
    written = 0

    def fill_up(_: int) -> None:
        nonlocal written
        written += 1
        if written == 2:  # the manifest, after the recording that it is to name
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", fill_up)
    with pytest.raises(OSError) as error:
        store.write_condition(opened, "a", recording(), CONDITION)
    monkeypatch.undo()
    assert error.value.errno == errno.ENOSPC and error.value.filename == str(tmp_path / "manifest.json")
    assert {path.name for path in tmp_path.iterdir()} == {"manifest.json", "a.safetensors"}
    assert store.adopt(store.create_or_open(tmp_path, {"seed": 1}), "a", CONDITION)


def test_no_other_file_is_adopted(tmp_path: Path) -> None:
    cut_before_the_manifest(tmp_path, {"seed": 1})
    assert not store.adopt(store.create_or_open(tmp_path, {"seed": 2}), "a", CONDITION)
    (tmp_path / "manifest.json").unlink()
    opened = store.create_or_open(tmp_path, {"seed": 1})
    assert not store.adopt(opened, "a", CONDITION | {"seed": 4})
    content = (tmp_path / "a.safetensors").read_bytes()
    for damaged in (content[:-4], content[:20], b""):
        (tmp_path / "a.safetensors").write_bytes(damaged)
        assert not store.adopt(opened, "a", CONDITION)
    assert store.read(tmp_path).names == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, c: a.pop("lean"), "'lean' is missing"),
        (lambda a, c: a.update(u=np.zeros((2, 5, 2))), "'u' has shape"),
        (lambda a, c: a["wrench_object"].__setitem__((0, 0, 0), np.nan), "'wrench_object'.*not finite"),
        (lambda a, c: c.pop("seed"), "'seed' is missing"),
        (lambda a, c: c.update(split="dev"), "use one of train, validation, test"),
    ],
)
def test_bad_recordings_are_refused(tmp_path: Path, change: object, message: str) -> None:
    arrays, condition = recording(), dict(CONDITION)
    change(arrays, condition)  # type: ignore[operator]
    with pytest.raises(ShmooError, match=message):
        store.write_condition(store.create_or_open(tmp_path, {}), "a", arrays, condition)


def test_states_remember_the_sample_before() -> None:
    arrays = {k: v.astype(np.float32) for k, v in recording().items()}
    samples = store.system_states(arrays)
    assert samples.state.object_pose.shape == (2, 4, 3) and samples.state.face.shape == (2, 4, 4)
    np.testing.assert_array_equal(samples.state.last_u[:, 0], 0.0)
    np.testing.assert_array_equal(samples.state.last_u[:, 1:], arrays["u"][:, :-2])
    np.testing.assert_array_equal(samples.state.last_force[:, 1:], arrays["force_robot"][:, :-2])
    body = se2.rotate(arrays["object_twist"][0, 0], -arrays["object_pose"][0, 0, 2])
    np.testing.assert_allclose(samples.state.last_object_twist[0, 1], body, rtol=1e-5)
