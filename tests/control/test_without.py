"""`benchmarks/without.py` leaves out one part of ours; `benchmarks/paper_parts.py` changes one of the paper's."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from shmoo_mjx.base import custom
from shmoo_mjx.behavior.methods import METHODS
from shmoo_mjx.behavior.push_task import pose_push_config
from shmoo_mjx.evaluation.pushing_trials import OWN
from shmoo_mjx.learning.weights import untrained

ROOT = Path(__file__).resolve().parents[2]
LEFT_OUT = {
    "running": {"cost.running_weight"},
    "lateral": {"cost.lateral_weight"},
    "heading": {"cost.heading_weight"},
    "aim": {"cost.aim_weight"},
    "speed": {"cost.speed_weight"},
    "overspeed": {"cost.overspeed_weight", "cost.slow_down"},
    "heading_and_overspeed": {"cost.heading_weight", "cost.overspeed_weight", "cost.slow_down"},
    "governor": {"governor.gain"},
    "governor_room": {"governor_room"},
    "foresees_governor": {"foresees_governor"},
    "running_lateral_foresees": {"cost.running_weight", "cost.lateral_weight", "foresees_governor"},
}
PAPER = {"metres": {"control.cost_scale"}, "governor": {"governor.gain"}, "white": {"control.noise_correlation"}}


def _flat(settings: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in settings.items():
        found |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return found


@pytest.mark.parametrize(
    ("module", "name", "changed"),
    [("without", *item) for item in LEFT_OUT.items()] + [("paper_parts", *item) for item in PAPER.items()],
)
def test_one_part_is_changed(monkeypatch: pytest.MonkeyPatch, module: str, name: str, changed: set[str]) -> None:
    monkeypatch.chdir(ROOT)
    whole = pose_push_config()
    pusher = custom.named(OWN, f"benchmarks.{module}:{name}")(untrained(), whole)
    before = _flat(asdict(whole if module == "without" else METHODS["paper"].pose_pushing))
    after = _flat(asdict(pusher.config))
    assert {key for key in before if before[key] != after[key]} == changed
