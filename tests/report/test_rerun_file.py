"""The 3-D recording: written whole if the viewer's package is there, refused in one sentence if not."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.report.rerun_file import write_rerun_file
from shmoo_mjx.report.trace import Trace


def test_without_the_package_it_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trace: Trace, result: dict[str, Any]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ShmooError, match="rerun-sdk; get it with"):
        write_rerun_file(tmp_path / "episode.rrd", result, trace)
    assert not list(tmp_path.iterdir())


def test_everything_that_happened_is_in_the_recording(tmp_path: Path, trace: Trace, result: dict[str, Any]) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    chunks = pytest.importorskip("rerun.chunk", reason="this rerun-sdk can't read recordings")
    short = trace._replace(
        **{n: getattr(trace, n)[:150] for n in ("t", "robot_pose", "lean", "u", "object_pose", "force", "state")},
        learned=trace.learned[:150],
        learned_object=trace.learned_object[:150],
    )
    path = write_rerun_file(tmp_path / "episode.rrd", result, short)
    assert path.stat().st_size > 10_000 and list(tmp_path.iterdir()) == [path]
    columns = {str(chunk.entity_path) for chunk in chunks.RrdReader(path).stream()}
    wanted = {"/world/walls", "/world/robot", "/world/robot/lean", "/world/objects/1", "/world/plan", "/world/rollouts"}
    assert wanted | {"/states", "/reasons", "/curves/force_N", "/curves/learned"} <= columns
