"""A data set on disk: a directory with one safetensors file per condition and a manifest.

The manifest lists every file with its checksum and condition. A file counts as recorded when the manifest lists it, so
an interrupted collection can resume. Reading a file that has changed since then raises an error. `adopt` adds complete
files that an interruption left out of the manifest. Only one process at a time may write a data set.
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
"""Version of the file format; increased when a field changes its meaning."""

SPLITS = ("train", "validation", "test")
"""Names of the splits. A condition belongs to one split with all its samples."""

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
"""Fields of a sample with their shapes after ``[E, L]``, for E episodes of L samples.

Poses and twists are in {W} at the start of the sample. The command u is held over the sample. The hands' force_robot
(in {R} at the start) and wrench_object (about the object's centre, in {O} at the start) are means over the sample. A
file also has face ``[E, 4]`` and size ``[E]``, see types.SystemState."""

MANIFEST = "manifest.json"
_MIRRORED = "-mirrored"
"""Suffix of the names of mirror images."""


class Store(NamedTuple):
    """An open data set directory."""

    directory: Path
    """Directory of the data set."""
    manifest: dict[str, Any]
    """Content of the manifest; writing a condition updates it in place."""

    def has(self, name: str) -> bool:
        """Whether the condition is recorded and its file matches the checksum."""
        entry = self.manifest["conditions"].get(name)
        if entry is None:
            return False
        path = self.directory / entry["file"]
        return path.is_file() and _checksum(path) == entry["sha256"]


class Dataset(NamedTuple):
    """A data set in memory. Each list has one entry per condition."""

    names: list[str]
    """Names of the conditions."""
    conditions: list[dict[str, Any]]
    """Conditions as plain data, with family, seed and split."""
    arrays: list[dict[str, np.ndarray]]
    """Recorded arrays of each condition, see `FIELDS`."""
    schema: dict[str, Any]
    """Settings of the collection."""

    def split(self, name: str) -> Dataset:
        """The conditions of one split: train, validation or test."""
        return self.chosen([i for i, condition in enumerate(self.conditions) if condition["split"] == name])

    def chosen(self, indices: Sequence[int]) -> Dataset:
        """The conditions with these indices."""
        return self._replace(
            names=[self.names[i] for i in indices],
            conditions=[self.conditions[i] for i in indices],
            arrays=[self.arrays[i] for i in indices],
        )

    def with_mirror_images(self) -> Dataset:
        """Append the mirror image of each condition. Returns the data set unchanged if it has mirror images already."""
        if any(name.endswith(_MIRRORED) for name in self.names):
            return self
        return self._replace(
            names=[*self.names, *(name + _MIRRORED for name in self.names)],
            conditions=[*self.conditions, *map(mirrored_condition, self.conditions)],
            arrays=[*self.arrays, *map(mirrored, self.arrays)],
        )


class Samples(NamedTuple):
    """Training samples of one condition: E episodes of L - 1 samples, since the last sample has no label."""

    state: SystemState
    """States at the start of the samples, fields ``[E, L - 1, ...]``."""
    u: np.ndarray
    """Commands [rad], ``[E, L - 1, 3]``."""
    robot_acceleration: np.ndarray
    """Labels: mean accelerations of the robot in {R} [m/s^2, rad/s^2], ``[E, L - 1, 3]``."""
    force: np.ndarray
    """Mean forces of the hands in {R} [N], ``[E, L - 1, 2]``."""
    wrench: np.ndarray
    """Mean wrenches of the hands on the object in {O} [N, N m], ``[E, L - 1, 3]``."""
    object_acceleration: np.ndarray
    """Labels: mean accelerations of the object in {O} [m/s^2, rad/s^2], ``[E, L - 1, 3]``."""
    contact: np.ndarray
    """Whether the hands touched the object, ``[E, L - 1]``."""


def create_or_open(directory: str | os.PathLike[str], schema: dict[str, Any]) -> Store:
    """Open the data set in ``directory``, or create an empty one.

    Args:
        directory: directory of the data set.
        schema: settings on which the whole collection depends (seeds, episode length, ...); must be JSON-serialisable.

    Raises:
        ShmooError: the directory contains a data set with another schema, or the manifest is damaged.
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
    """Add one condition to a data set. First its file and then the manifest is written, each atomically.

    Args:
        store: data set from `create_or_open`.
        name: unique name, used as the file's name.
        arrays: all entries of FIELDS ``[E, L, ...]``, face ``[E, 4]`` and size ``[E]``.
        condition: JSON-serialisable condition, with at least family, seed and split.

    Raises:
        ShmooError: an array is missing, has a wrong shape or contains a non-finite value; or the condition lacks
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
    """Add a complete file to the manifest, if `write_condition` was interrupted before it could do so.

    Args:
        store: data set from `create_or_open`.
        name: name of the condition.
        condition: condition that the file must contain.

    Returns:
        Whether a file was added. It must be complete, of this condition, and of a data set with the same schema.
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
        ShmooError: the directory contains no data set, or a file is missing or does not match its checksum.
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
    """Read the manifest of a data set: schema, versions and conditions.

    Raises:
        ShmooError: the directory contains no data set, or the manifest is damaged.
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
    """SHA-256 of a data set's schema and of all its files, independent of the order in which they were written."""
    manifest = read_manifest(directory)
    files = sorted((name, entry["sha256"]) for name, entry in manifest["conditions"].items())
    return hashlib.sha256(json.dumps([manifest["schema"], files], sort_keys=True).encode()).hexdigest()


def of_training(data: str | os.PathLike[str] | Dataset) -> Dataset:
    """The train and validation conditions of a data set with their mirror images.

    Args:
        data: directory of the data set, or a loaded data set.

    Raises:
        ShmooError: the data set can't be read (see `read`), or one of the two splits is empty.
    """
    dataset = data if isinstance(data, Dataset) else read(data, splits=("train", "validation"))
    for split in ("train", "validation"):
        if not dataset.split(split).names:
            where = "the data set" if isinstance(data, Dataset) else os.fspath(data)
            raise ShmooError(f"{where}: field 'split' is '{split}' for no condition; collect some for training.")
    return dataset.with_mirror_images()


def system_states(arrays: dict[str, np.ndarray]) -> Samples:
    """Convert one condition's arrays to states, commands and labels.

    The ``last_*`` fields contain the values of the previous sample, and zeros at an episode's start.
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
    """Metadata of a file, as one entry: safetensors writes several in random order, which would change the checksum."""
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
    """Reject entries that `write_condition` can't have made, above all files outside the data set's folder."""
    schema.items()
    for name, entry in conditions.items():
        if entry["file"] != f"{name}.safetensors" or Path(entry["file"]).name != entry["file"]:
            raise ShmooError(f"{path}: condition {name!r} has the file {entry['file']!r}; it must be NAME.safetensors.")
        _check_condition(name, entry["condition"])
        if not isinstance(entry["sha256"], str):
            raise TypeError(f"no checksum of condition {name!r}")


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
