"""Storage of pytrees in safetensors files, with JSON notes in the header and a checksum of the contents."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import jax
import numpy as np

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.errors import ShmooError

Tree = Any


def save_tree(path: str | os.PathLike[str], tree: Tree, notes: dict[str, Any]) -> None:
    """Write ``tree`` and ``notes``, which must be valid JSON, to ``path``, atomically."""
    from safetensors.numpy import save

    arrays = _flatten(tree)
    # Use one entry: safetensors writes several entries in arbitrary order, so equal trees would give different files.
    header = {"notes": json.dumps(notes | {"sha256": _checksum(arrays)})}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, save(arrays, metadata=header))


def read_notes(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the notes of a file written by `save_tree`.

    Raises:
        ShmooError: the file is missing or damaged.
    """
    return _read(Path(path))[1]


def load_tree(path: str | os.PathLike[str], like: Tree) -> tuple[Tree, dict[str, Any]]:
    """Read a file written by `save_tree`.

    Args:
        path: the file.
        like: tree of arrays or shapes that gives the structure of the result.

    Returns:
        The tree and the notes.

    Raises:
        ShmooError: the file is missing or damaged, or its names or shapes differ from ``like``.
    """
    path = Path(path)
    arrays, notes = _read(path)
    leaves = jax.tree_util.tree_leaves_with_path(like)
    wanted = {jax.tree_util.keystr(key, simple=True, separator="."): leaf for key, leaf in leaves}
    for name, leaf in wanted.items():
        if name not in arrays:
            raise ShmooError(f"{path}: field '{name}' is missing; use a file that this version wrote.")
        if arrays[name].shape != np.shape(leaf):
            raise ShmooError(
                f"{path}: field '{name}' has shape {arrays[name].shape} where {np.shape(leaf)} is needed; use a file "
                "that was trained with this configuration."
            )
    ordered = [arrays[name] for name in wanted]
    return jax.tree.unflatten(jax.tree.structure(like), ordered), notes


def _flatten(tree: Tree) -> dict[str, np.ndarray]:
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(key, simple=True, separator="."): np.array(leaf, order="C") for key, leaf in leaves}


def _checksum(arrays: dict[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].shape} {arrays[name].dtype}".encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()


def _read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        what = "is no file" if path.exists() else "there is no such file"
        raise ShmooError(f"{path}: {what}; train first or give the path of a weights file.")
    try:
        with safe_open(path, framework="numpy") as file:
            header = file.metadata() or {}
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator of its own
        notes = json.loads(header.get("notes", "{}"))
        # Files of schema 3 store the checksum outside the notes.
        checksum = header.get("sha256") or notes.pop("sha256", None)
        if checksum is None:
            raise ShmooError(f"{path}: another program's safetensors file; give one that shmoo train wrote.")
        intact = checksum == _checksum(arrays)
    except (SafetensorError, KeyError, ValueError, AttributeError, OSError) as error:
        raise ShmooError(f"{path}: the file is damaged ({error}); train again or fetch it anew.") from None
    if not intact:
        raise ShmooError(f"{path}: the file is damaged (field 'sha256' does not fit); train again or fetch it anew.")
    return arrays, notes
