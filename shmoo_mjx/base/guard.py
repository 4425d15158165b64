"""Checks of output paths: a command must not replace its input files or files of another kind."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from tempfile import TemporaryFile

from shmoo_mjx.errors import ShmooError

PNG = "a PNG picture"
FILM = "a film"
HTML = "an HTML page"
TEXT = "a text file"
BINARY = "a binary file"
VIEWER = "a recording for the Rerun viewer"
ARRAYS = "an archive of arrays"
TABLE = "a Parquet table"
WEIGHTS = "a weights file"
MAP = "a map's YAML"
SCENARIO = "a scenario"
RUN = "the result of a run"
RECORDING = "the result of a recording"
EXPERIMENT = "the result of an experiment"
SCENARIO_SET = "a scenario set"
OBJECT = "an object file"
SWEEP = "the notes of a sweep"

_MAGIC = {
    b"\x89PNG": PNG,
    b"\xff\xd8\xff": "a JPEG picture",
    b"GIF8": "a GIF picture",
    b"PK\x03\x04": ARRAYS,
    b"PAR1": TABLE,
    b"\x1f\x8b": "a compressed file",
    b"RRF": VIEWER,
    b"%PDF": "a PDF document",
}
_YAML_KEYS = {"image": MAP, "start": SCENARIO}
_JSON_KEYS = {
    "experiment": EXPERIMENT,
    "outcome": RUN,
    "hull": OBJECT,
    "scenarios": SCENARIO_SET,
    "fingerprint": SWEEP,
    "conditions": "the manifest of a data set",
}
"""Kind of a JSON file by the top-level key that identifies it."""

_Identity = tuple[int, int]
_INPUTS: ContextVar[Mapping[_Identity, Path]] = ContextVar("inputs", default={})  # noqa: B039  (never changed)


@contextmanager
def protected(inputs: Iterable[str | Path]) -> Iterator[None]:
    """Context manager in which `check_output` rejects the files ``inputs``, also under other names and links."""
    files = dict(_INPUTS.get())
    for path in map(Path, inputs):
        if (identity := _identity(path)) is not None:
            files[identity] = path
    token = _INPUTS.set(files)
    try:
        yield
    finally:
        _INPUTS.reset(token)


def check_output(path: str | Path, kind: str = "", suffix: str = "") -> None:
    """Check that ``path`` may and can be written.

    Args:
        path: file to write; it need not exist.
        kind: kind of the new content, as returned by `kind_of`; empty to skip the check of the kind.
        suffix: suffix that the name must have; empty to allow any.

    Raises:
        OSError: no file can be created there; its filename is ``path``.
        ShmooError: the file is a folder or an input, has another suffix, or is not empty and of another kind.
    """
    path = Path(path)
    if path.is_dir():
        raise ShmooError(f"{path}: is a folder; give the name of a file for the output.")
    if not path.name.endswith(suffix):
        raise ShmooError(f"{path}: must end in {suffix}; choose another name for the output.")
    identity = _identity(path)
    if identity is not None and identity in _INPUTS.get():
        read = _INPUTS.get()[identity]
        which = "" if read == path else f"{read}, "
        raise ShmooError(f"{path}: is {which}an input of this command; choose another place for the output.")
    if kind and path.is_file() and path.stat().st_size and (there := kind_of(path)) != kind:
        raise ShmooError(f"{path}: is {there}, which {kind} would replace; choose another place for the output.")
    existing = next((parent for parent in path.parents if parent.exists()), path.parent)
    try:
        # Permissions do not tell: root may write everywhere, but not into /proc.
        with TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def check_folder(folder: Path, files: Mapping[str, str], mark: str) -> None:
    """Check, before any computation, that all output files may be written into ``folder``.

    Args:
        folder: output folder; it need not exist.
        files: kind of each output file by its name.
        mark: name of the file that a command writes first. In a folder without it, existing files with the other names
            do not come from an earlier run and must not be replaced.

    Raises:
        OSError, ShmooError: the folder is a file, or one of the files may not or can not be written, see
            `check_output`.
    """
    if folder.exists() and not folder.is_dir():
        raise ShmooError(f"{folder}: is a file; choose a folder for the output.")
    for name, kind in files.items():
        check_output(folder / name, kind)
    for name in files:
        if (folder / name).is_file() and not (folder / mark).is_file():
            raise ShmooError(
                f"{folder / name}: was not written by an earlier run; choose another folder for the output."
            )


def kind_of(path: Path, name: str = "") -> str:
    """Kind of a file in words, from its content, and for YAML also from the suffix of ``name`` (by default its own)."""
    with path.open("rb") as file:
        head = file.read(4096)
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    if head[4:8] == b"ftyp":
        return FILM
    if head[8:9] == b"{" and int.from_bytes(head[:8], "little") < 100_000_000:
        return "a recorded condition" if b'"condition":' in head else WEIGHTS
    if b"\0" in head:
        return BINARY
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if start.startswith((b"<!doctype html", b"<html")):
        return HTML
    if start.startswith((b"{", b"[")):
        return _json_kind(path)
    if Path(name or path).suffix.lower() in (".yaml", ".yml"):
        keys = re.findall(rb"^[\"']?(\w+)[\"']?\s*:", path.read_bytes(), re.MULTILINE)
        return next((kind for key, kind in _YAML_KEYS.items() if key.encode() in keys), "a YAML file")
    return TEXT


def _json_kind(path: Path) -> str:
    try:
        data = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return TEXT
    if not isinstance(data, dict):
        return "a JSON file"
    if data.get("outcome") == "log":
        return RECORDING
    return next((kind for key, kind in _JSON_KEYS.items() if key in data), "a JSON file")


def _identity(path: Path) -> _Identity | None:
    """Device and inode, as `os.path.samefile` compares them; None if there is no file."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return (status.st_dev, status.st_ino) if status.st_ino else None
