"""What ``import shmoo_mjx`` offers: every name is there, has a docstring and a line on its page, and costs nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import shmoo_mjx

PAGE = Path(__file__).resolve().parents[1] / "docs" / "architecture.md"


@pytest.mark.parametrize("name", shmoo_mjx.__all__)
def test_each_name_is_there_and_explained(name: str) -> None:
    assert getattr(shmoo_mjx, name).__doc__
    assert f"`{name}`" in PAGE.read_text(encoding="utf-8")


def test_the_import_alone_brings_nothing_heavy() -> None:
    code = "import sys, shmoo_mjx; assert not {'jax', 'mujoco', 'numpy'} & set(sys.modules), sorted(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_what_is_not_offered_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = shmoo_mjx.nothing_of_the_kind  # type: ignore[attr-defined]


def test_a_file_in_place_of_weights_is_refused() -> None:
    with pytest.raises(shmoo_mjx.ShmooError, match="load_weights"):
        shmoo_mjx.PushController("demo.safetensors")  # type: ignore[arg-type]
