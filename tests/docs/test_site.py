"""The site shows every page and every part of the package."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
RESULTS = "results.md"
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text())


def pages_of(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    entries = nav if isinstance(nav, list) else nav.values()
    return [page for entry in entries for page in pages_of(entry)]


def test_the_navigation_leads_to_every_page_once() -> None:
    there = {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    listed = pages_of(CONFIG["nav"])
    assert sorted(listed) == sorted(set(listed))
    # The page of results is written by the experiments.
    assert set(listed) - {RESULTS} == there - {RESULTS} and RESULTS in listed


def test_the_reference_names_every_part_of_the_package() -> None:
    text = "\n".join(p.read_text() for p in (ROOT / "docs" / "reference").glob("*.md"))
    named = set(re.findall(r"^::: (shmoo_mjx\.\w+)$", text, re.MULTILINE))
    folders = {f"shmoo_mjx.{p.parent.name}" for p in (ROOT / "shmoo_mjx").glob("*/__init__.py")}
    modules = {f"shmoo_mjx.{p.stem}" for p in (ROOT / "shmoo_mjx").glob("*.py") if p.stem != "__init__"}
    assert named == folders | modules


def test_links_to_the_source_become_links_to_the_reference() -> None:
    spec = importlib.util.spec_from_file_location("links", ROOT / "docs" / "links.py")
    assert spec and spec.loader
    links = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(links)

    class Page:
        class file:
            src_uri = "plant.md"

    text = "[a](../shmoo_mjx/plant/objects.py) [b](../shmoo_mjx/run/scenario_run.py) [c](../README.md) [d](gym.md)"
    there = "[a](reference/plant.md#shmoo_mjx.plant.objects) [b](reference/run.md#shmoo_mjx.run.scenario_run)"
    assert links.on_page_markdown(text, Page) == f"{there} c [d](gym.md)"
    Page.file.src_uri = "how_to/robot.md"
    text = "[a](../../shmoo_mjx/plant/robot.py) [b](../plant.md#engines) [c](../../README.md) [d](object.md)"
    there = "[a](../reference/plant.md#shmoo_mjx.plant.robot) [b](../plant.md#engines) c [d](object.md)"
    assert links.on_page_markdown(text, Page) == there


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    for needed in ("mkdocs", "material", "mkdocstrings"):
        if importlib.util.find_spec(needed) is None:
            pytest.skip(f"the extra docs ({needed}) is not installed")
    if not (ROOT / "docs" / RESULTS).exists():
        pytest.skip("docs/results.md, which the experiments write, is not there yet")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    env = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "draw_condition" in (tmp_path / "reference" / "plant" / "index.html").read_text()
