"""Files that others' tools read say what the repository says elsewhere."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import shmoo_mjx

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def load(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_the_citation_is_of_this_version_and_names_the_paper() -> None:
    citation, readme = load("CITATION.cff"), (ROOT / "README.md").read_text(encoding="utf-8")
    assert citation["version"] == PROJECT["project"]["version"] and citation["license"] == PROJECT["project"]["license"]
    software = re.search(r"@software\{.*?\n\}", readme, re.DOTALL)
    assert software and f"{{{citation['title']}}}" in software[0] and f"{{{citation['version']}}}" in software[0]
    assert f"{{{citation['date-released'].year}}}" in software[0] and citation["version"] == shmoo_mjx.__version__
    (paper,) = citation["references"]
    assert f"{{{paper['title']}}}" in readme and f"{{{paper['journal']}}}" in readme and str(paper["year"]) in readme
    named = " and ".join(f"{a['family-names']}, {a['given-names']}" for a in paper["authors"])
    assert f"{{{named}}}" in readme


def test_the_workflow_runs_the_readmes_two_lines_and_all_checks() -> None:
    jobs = load(".github/workflows/ci.yml")["jobs"]
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    block = re.search(r"```bash\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None
    lines = [line for line in block[1].splitlines() if line.startswith("pip install uv")]
    assert len(lines) == 2 and [*lines, ".ci/run"] == commands


def test_the_hooks_run_what_the_checks_run() -> None:
    (local,) = load(".pre-commit-config.yaml")["repos"]
    checks = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for hook in local["hooks"]:
        assert " ".join(hook["entry"].split()[:4]) in checks


def test_the_paper_cites_what_its_bibliography_has() -> None:
    text, entries = ((ROOT / name).read_text(encoding="utf-8") for name in ("paper.md", "paper.bib"))
    cited = set(re.findall(r"(?<![\w.])@(\w+)", text))
    assert cited and cited == set(re.findall(r"^@\w+\{(\w+),", entries, re.MULTILINE))
    assert load("CITATION.cff")["title"] in text


def test_the_changelog_ends_with_this_version_and_earlier_ones_have_a_tag() -> None:
    versions = re.findall(
        r"^## \[?v?(\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    found = subprocess.run(["git", "tag"], cwd=ROOT, capture_output=True, text=True, check=False)
    if found.returncode:
        pytest.skip("this is no git repository")
    # The tag of the newest version is set once its changes are merged.
    assert versions[0] == PROJECT["project"]["version"]
    assert {v.removeprefix("v") for v in found.stdout.split()} >= set(versions[1:])


def test_least_versions_are_declared_and_constraints_meet_them() -> None:
    pinned = dict(pin.split("==") for pin in PROJECT["tool"]["uv"]["constraint-dependencies"])
    wanted = [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["dev"]]
    for requirement in wanted:
        name, sign, least = re.fullmatch(r"([\w.-]+)(?:\[.*\])?(>=|==)([\d.]+)", requirement).groups()  # type: ignore[union-attr]
        have = [int(n) for n in re.findall(r"\d+", pinned[name.lower()])]
        assert have >= [int(n) for n in least.split(".")], (name, sign)
