"""A data set on disk: a directory with one safetensors file per condition and a manifest.

The manifest names every file with its checksum and its condition. A file counts as recorded once the manifest names it,
so collection that was cut short goes on where it stopped, and a file that changed afterwards is named, not read. What
was written whole just before the cut, and not named yet, is `adopt`ed. One process at a time may write a data set.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.data import differentiate
from shmoo_mjx.data.mirror import mirrored, mirrored_condition
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.types import DT, SystemState

SCHEMA_VERSION = 1
"""Raised whenever a field of a condition's file changes its meaning."""

SPLITS = ("train", "validation", "test")
"""Splits are by condition, never by row."""

FIELDS: dict[str, tuple[int, ...]] = {
    "robot_pose": (3,),
    "robot_twist": (3,),
    "lean": (2,),
    "lean_rate": (2,),
    "object_pose": (3,),
    "object_twist": (3,),
    "u": (3,),
    "force_robot": (2,),
    "wrench_object": (3,),
    "contact": (),
}
"""Per sample: what follows ``[E, L]`` for E episodes of L samples. Poses and twists are in {W} at the start of the
sample; u is held over it; force_robot ({R} at its start) and wrench_object (about the object's centre, {O} at its
start) are means over it. Beside these a file has face ``[E, 4]`` and size ``[E]`` as types.SystemState tells them."""

MANIFEST = "manifest.json"
_MIRRORED = "-mirrored"
"""What the name of a mirror image ends in."""


class Store(NamedTuple):
    """An open data set directory."""

    directory: Path
    manifest: dict[str, Any]

    def has(self, name: str) -> bool:
        """Whether the condition is recorded and its file is as it was written."""
        entry = self.manifest["conditions"].get(name)
        if entry is None:
            return False
        path = self.directory / entry["file"]
        return path.is_file() and _checksum(path) == entry["sha256"]


class Dataset(NamedTuple):
    """What `read` found, one entry per condition in each list."""

    names: list[str]
    conditions: list[dict[str, Any]]
    arrays: list[dict[str, np.ndarray]]
    schema: dict[str, Any]

    def split(self, name: str) -> Dataset:
        """The conditions of one split: train, validation or test."""
        return self.chosen([i for i, condition in enumerate(self.conditions) if condition["split"] == name])

    def chosen(self, indices: Sequence[int]) -> Dataset:
        """Some of the conditions, by their places."""
        return self._replace(
            names=[self.names[i] for i in indices],
            conditions=[self.conditions[i] for i in indices],
            arrays=[self.arrays[i] for i in indices],
        )

    def with_mirror_images(self) -> Dataset:
        """The data set and, behind it, the mirror image of each of its conditions as another one. Done once only."""
        if any(name.endswith(_MIRRORED) for name in self.names):
            return self
        return self._replace(
            names=[*self.names, *(name + _MIRRORED for name in self.names)],
            conditions=[*self.conditions, *map(mirrored_condition, self.conditions)],
            arrays=[*self.arrays, *map(mirrored, self.arrays)],
        )


class Samples(NamedTuple):
    """A condition's file as the learners take it; L - 1 samples have a label."""

    state: SystemState
    """``[E, L - 1, ...]``"""
    u: np.ndarray
    """``[E, L - 1, 3]`` [rad]"""
    robot_acceleration: np.ndarray
    """``[E, L - 1, 3]`` in {R}"""
    force: np.ndarray
    """``[E, L - 1, 2]`` in {R} [N]"""
    wrench: np.ndarray
    """``[E, L - 1, 3]`` in {O} [N, N m]"""
    object_acceleration: np.ndarray
    """``[E, L - 1, 3]`` in {O}"""
    contact: np.ndarray
    """``[E, L - 1]`` bool"""


def create_or_open(directory: str | os.PathLike[str], schema: dict[str, Any]) -> Store:
    """Open the data set in ``directory``, or start an empty one.

    ``schema`` is what the whole collection depends on (seeds, episode length, ...), JSON-able.

    Raises:
        ShmooError: the directory holds a data set made with another schema, or a damaged manifest.
    """
    directory = Path(directory)
    path = directory / MANIFEST
    wanted = json.loads(json.dumps(schema))
    if path.exists():
        manifest = read_manifest(directory)
        if manifest["schema"] != wanted:
            raise ShmooError(
                f"{path}: field 'schema' says the data set was collected with other settings; choose an empty "
                "directory or the settings it was started with."
            )
        return Store(directory, manifest)
    directory.mkdir(parents=True, exist_ok=True)
    versions = {package: metadata.version(package) for package in ("shmoo-mjx", "mujoco", "jax", "numpy")}
    manifest = {"schema_version": SCHEMA_VERSION, "schema": wanted, "versions": versions, "conditions": {}}
    write_whole(path, json.dumps(manifest, indent=1).encode())
    return Store(directory, manifest)


def write_condition(store: Store, name: str, arrays: dict[str, np.ndarray], condition: dict[str, Any]) -> None:
    """Add one condition: its file first, then the manifest that names it, each written whole or not at all.

    Args:
        store: from `create_or_open`.
        name: unique; becomes the file's name.
        arrays: every entry of FIELDS ``[E, L, ...]``, face ``[E, 4]`` and size ``[E]``.
        condition: JSON-able, with at least family, seed and split.

    Raises:
        ShmooError: an array is missing, has another shape or holds a value that is not finite; a condition without
            family, seed or a known split.
    """
    from safetensors.numpy import save

    _check_arrays(name, arrays)
    _check_condition(name, condition)
    typed = {k: np.ascontiguousarray(v, dtype=bool if k == "contact" else np.float32) for k, v in arrays.items()}
    path = store.directory / f"{name}.safetensors"
    content = save(typed, metadata={"condition": _origin(store, condition)})
    write_whole(path, content)
    _name(store, name, hashlib.sha256(content).hexdigest(), condition)


def adopt(store: Store, name: str, condition: dict[str, Any]) -> bool:
    """Name in the manifest the file of a condition that `write_condition` was stopped before it could name.

    Returns:
        Whether there was one: whole, of this condition, and of a data set with the same schema.
    """
    from safetensors import SafetensorError, safe_open
    from safetensors.numpy import load

    path = store.directory / f"{name}.safetensors"
    if name in store.manifest["conditions"] or not path.is_file():
        return False
    content = path.read_bytes()
    try:
        with safe_open(path, framework="numpy") as file:
            origin = (file.metadata() or {}).get("condition")
        _check_arrays(name, load(content))
    except (SafetensorError, ShmooError):
        return False
    if origin != _origin(store, condition):
        return False
    _name(store, name, hashlib.sha256(content).hexdigest(), condition)
    return True


def read(directory: str | os.PathLike[str], splits: tuple[str, ...] = SPLITS) -> Dataset:
    """Read the conditions of the given splits.

    Raises:
        ShmooError: no data set there, or a file that is missing or differs from what was written.
    """
    from safetensors.numpy import load

    directory = Path(directory)
    manifest = read_manifest(directory)
    names, conditions, arrays = [], [], []
    for name, entry in sorted(manifest["conditions"].items()):
        if entry["condition"]["split"] not in splits:
            continue
        path = directory / entry["file"]
        if not path.is_file():
            raise ShmooError(f"{path}: the file of condition '{name}' is missing; collect again to make it anew.")
        content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != entry["sha256"]:
            raise ShmooError(
                f"{path}: the file of condition '{name}' is damaged (field 'sha256' does not fit); delete it and "
                "collect again to make it anew."
            )
        names.append(name)
        conditions.append(entry["condition"])
        arrays.append(load(content))
    return Dataset(names, conditions, arrays, manifest["schema"])


def read_manifest(directory: str | os.PathLike[str]) -> dict[str, Any]:
    """A data set's manifest: schema, versions and conditions.

    Raises:
        ShmooError: no data set there, or a damaged manifest.
    """
    path = Path(directory) / MANIFEST
    if not path.is_file():
        raise ShmooError(f"{path}: there is no data set here; give the directory that `shmoo collect` wrote.")
    try:
        manifest = json.loads(path.read_text())
        version = manifest["schema_version"]
        if version == SCHEMA_VERSION:
            _check_entries(path, manifest["schema"], manifest["conditions"])
            manifest["versions"].items()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ShmooError(
            f"{path}: the manifest is damaged ({error}); delete the directory and collect again."
        ) from None
    if version != SCHEMA_VERSION:
        raise ShmooError(
            f"{path}: field 'schema_version' is {version}, this version reads {SCHEMA_VERSION}; collect again."
        )
    return manifest


def fingerprint_of(directory: str | os.PathLike[str]) -> str:
    """SHA-256 of how a data set was collected and of every file in it, in whatever order these were written."""
    manifest = read_manifest(directory)
    files = sorted((name, entry["sha256"]) for name, entry in manifest["conditions"].items())
    return hashlib.sha256(json.dumps([manifest["schema"], files], sort_keys=True).encode()).hexdigest()


def of_training(data: str | os.PathLike[str] | Dataset) -> Dataset:
    """The train and validation conditions of a data set, given as a directory or read already, and their mirror images.

    Raises:
        ShmooError: as `read`; or one of the two splits is empty.
    """
    dataset = data if isinstance(data, Dataset) else read(data, splits=("train", "validation"))
    for split in ("train", "validation"):
        if not dataset.split(split).names:
            where = "the data set" if isinstance(data, Dataset) else os.fspath(data)
            raise ShmooError(f"{where}: field 'split' is '{split}' for no condition; collect some for training.")
    return dataset.with_mirror_images()


def system_states(arrays: dict[str, np.ndarray]) -> Samples:
    """The states, commands and labels of one condition's arrays.

    The last_* fields are the values of the sample before, zeros at an episode's start.
    """
    object_pose, object_twist = arrays["object_pose"], arrays["object_twist"]
    body_twist = np.asarray(se2.rotate(object_twist, -object_pose[..., 2]))
    n = object_pose.shape[1] - 1
    state = SystemState(
        robot_pose=arrays["robot_pose"][:, :-1],
        robot_twist=arrays["robot_twist"][:, :-1],
        lean=arrays["lean"][:, :-1],
        lean_rate=arrays["lean_rate"][:, :-1],
        object_pose=object_pose[:, :-1],
        object_twist=object_twist[:, :-1],
        last_object_twist=_before(body_twist)[:, :-1],
        last_wrench=_before(arrays["wrench_object"])[:, :-1],
        last_force=_before(arrays["force_robot"])[:, :-1],
        last_u=_before(arrays["u"])[:, :-1],
        face=np.repeat(arrays["face"][:, None], n, axis=1),
        size=np.repeat(arrays["size"][:, None], n, axis=1),
    )
    return Samples(
        state=state,
        u=arrays["u"][:, :-1],
        robot_acceleration=differentiate.body_acceleration(arrays["robot_pose"], arrays["robot_twist"], DT),
        force=arrays["force_robot"][:, :-1],
        wrench=arrays["wrench_object"][:, :-1],
        object_acceleration=differentiate.body_acceleration(object_pose, object_twist, DT),
        contact=arrays["contact"][:, :-1].astype(bool),
    )


def _origin(store: Store, condition: dict[str, Any]) -> str:
    """What a file says of itself. In one entry: safetensors writes several in any order, which changes the checksum."""
    schema = json.dumps(store.manifest["schema"], sort_keys=True).encode()
    return json.dumps(condition | {"schema_sha256": hashlib.sha256(schema).hexdigest()})


def _name(store: Store, name: str, checksum: str, condition: dict[str, Any]) -> None:
    entry = {"file": f"{name}.safetensors", "sha256": checksum, "condition": condition}
    store.manifest["conditions"][name] = json.loads(json.dumps(entry))
    write_whole(store.directory / MANIFEST, json.dumps(store.manifest, indent=1).encode())


def _before(values: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros_like(values[:, :1]), values[:, :-1]], axis=1)


def _check_arrays(name: str, arrays: dict[str, np.ndarray]) -> None:
    missing = sorted({*FIELDS, "face", "size"} - set(arrays))
    if missing:
        raise ShmooError(f"condition '{name}': field '{missing[0]}' is missing; a recording needs every field.")
    lead = np.shape(arrays["robot_pose"])[:2]
    shapes = {k: (*lead, *tail) for k, tail in FIELDS.items()} | {"face": (*lead[:1], 4), "size": lead[:1]}
    for key, shape in shapes.items():
        if np.shape(arrays[key]) != shape:
            raise ShmooError(
                f"condition '{name}': field '{key}' has shape {np.shape(arrays[key])}; it must be {shape}."
            )
        if not np.all(np.isfinite(arrays[key])):
            raise ShmooError(f"condition '{name}': field '{key}' holds a value that is not finite; record it again.")


def _check_condition(name: str, condition: dict[str, Any]) -> None:
    for key in ("family", "seed", "split"):
        if key not in condition:
            raise ShmooError(f"condition '{name}': field '{key}' is missing; name its family, seed and split.")
    if condition["split"] not in SPLITS:
        raise ShmooError(
            f"condition '{name}': field 'split' is '{condition['split']}'; use one of {', '.join(SPLITS)}."
        )


def _check_entries(path: Path, schema: dict[str, Any], conditions: dict[str, Any]) -> None:
    """Refuse entries that `write_condition` does not make: above all files outside the data set's folder."""
    schema.items()
    for name, entry in conditions.items():
        if entry["file"] != f"{name}.safetensors" or Path(entry["file"]).name != entry["file"]:
            raise ShmooError(f"{path}: condition {name!r} has the file {entry['file']!r}; it must be NAME.safetensors.")
        _check_condition(name, entry["condition"])
        if not isinstance(entry["sha256"], str):
            raise TypeError(f"no checksum of condition {name!r}")


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
