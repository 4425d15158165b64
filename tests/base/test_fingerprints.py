"""A kept result comes back for the same settings, files and code, and for no others."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.base import fingerprints
from shmoo_mjx.base.fingerprints import code_hash, fingerprint

ROOT = Path(fingerprints.__file__).parents[1]


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The package's sources, to be changed."""
    shutil.copytree(ROOT, tmp_path / "shmoo_mjx", ignore=shutil.ignore_patterns("__pycache__", "*.safetensors"))
    monkeypatch.setattr(fingerprints, "_ROOT", tmp_path / "shmoo_mjx")
    code_hash.cache_clear()
    yield tmp_path / "shmoo_mjx"
    code_hash.cache_clear()


def test_a_fingerprint_changes_with_settings_files_and_arrays(tmp_path: Path) -> None:
    file, array = tmp_path / "weights", np.arange(6.0)
    file.write_bytes(b"1")
    first = fingerprint("shmoo_mjx.geometry.se2", {"a": 1, "b": 2}, file, array)
    assert first == fingerprint("shmoo_mjx.geometry.se2", {"b": 2, "a": 1}, file, array.copy())
    others = [
        fingerprint("shmoo_mjx.geometry.se2", {"a": 1, "b": 3}, file, array),
        fingerprint("shmoo_mjx.geometry.se2", {"a": 1, "b": 2}, file, array + 1),
        fingerprint("shmoo_mjx.geometry.faces", {"a": 1, "b": 2}, file, array),
    ]
    file.write_bytes(b"2")
    others.append(fingerprint("shmoo_mjx.geometry.se2", {"a": 1, "b": 2}, file, array))
    assert len({first, *others}) == 5


@pytest.mark.parametrize(
    ("module", "part"),
    [
        ("shmoo_mjx.learning.daiml", "learning/multistep.py"),
        ("shmoo_mjx.evaluation.navigation", "behavior/push_decisions.py"),
        ("shmoo_mjx.sweep.simulate", "plant/engine_mjx.py"),
    ],
)
def test_code_that_is_imported_however_late_counts_and_its_comments_and_docstrings_do_not(
    copy: Path, module: str, part: str
) -> None:
    before = code_hash(module)
    source = (copy / part).read_text()
    for text, changed in (("# a remark", False), ('"""Another."""', False), ("CHANGED = 1", True)):
        (copy / part).write_text(f"{source}\n{text}\n")
        code_hash.cache_clear()
        assert (code_hash(module) != before) == changed


def test_code_that_is_not_imported_does_not_count(copy: Path) -> None:
    before = code_hash("shmoo_mjx.learning.daiml")
    (copy / "behavior" / "verdicts.py").write_text("CHANGED = 1\n")
    code_hash.cache_clear()
    assert code_hash("shmoo_mjx.learning.daiml") == before


def test_a_changed_plant_counts_for_what_imports_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    models = tmp_path / "models_xml"
    shutil.copytree(fingerprints.asset("models_xml"), models)
    monkeypatch.setattr(fingerprints, "asset", lambda path: tmp_path / path)

    def hashes() -> tuple[str, str]:
        code_hash.cache_clear()
        return code_hash("shmoo_mjx.evaluation.pushing"), code_hash("shmoo_mjx.geometry.se2")

    before = hashes()
    cart = models / "objects" / "cart.xml"
    cart.write_text(cart.read_text().replace("0.985", "0.95"))
    after = hashes()
    assert before[0] != after[0] and before[1] == after[1]
    code_hash.cache_clear()
