"""Somebody else's navigation policy drives in the place of ours; whatever is wrong with it is said in one sentence."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.base import custom
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid, save_map
from shmoo_mjx.planning.scenario import Limits, ObjectEntry, Scenario, save_scenario
from shmoo_mjx.run.episode import run_episode

PAGE = (Path(__file__).resolve().parents[2] / "docs/how_to/policy.md").read_text()
GO_ROUND, STRAIGHT = (part.partition("```")[0] for part in PAGE.split("```python\n")[1:3])
BAD = """
import numpy as np
from shmoo_mjx.types import Command

class Base:
    finished = False
    def __init__(self, grid, goal, sizes, controller, config):
        pass

class StopsAtOnce(Base):
    finished = True
    def tick(self, seen):
        return Command(np.zeros((1, 3)), np.zeros(1), np.array([0.3]), np.array([0.7]))

class Fails(Base):
    def tick(self, seen):
        return seen.nothing

class Shapeless(Base):
    def tick(self, seen):
        return Command(np.zeros(3), np.zeros(1), np.zeros(1), np.zeros(1))

class Broken(Base):
    def tick(self, seen):
        return Command(np.full((1, 3), np.nan), np.zeros(1), np.zeros(1), np.zeros(1))
"""


@pytest.fixture(autouse=True)
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, text in {
        "go_round": GO_ROUND,
        "straight": STRAIGHT,
        "bad": BAD,
        "torn": "import nothing_like_it",
    }.items():
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.fixture(scope="module")
def controller() -> PushController:
    return PushController(load_weights())


def room() -> OccupancyGrid:
    cells = np.zeros((60, 120), dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    return OccupancyGrid(cells, resolution=0.05)


def scenario(*objects: ObjectEntry) -> Scenario:
    return Scenario(start=(1.0, 1.5, 0.0), goal=(3.5, 1.5), objects=objects, limits=Limits(time_s=40))


def run(controller: PushController, policy: str, *objects: ObjectEntry) -> dict[str, Any]:
    return run_episode(room(), scenario(*objects), controller, senses="perfect", policy=policy).result


def test_the_page_s_policies_reach_the_goal(controller: PushController) -> None:
    assert run(controller, "straight:Straight")["outcome"] == "success"
    box = ObjectEntry(family="box", pose=(2.3, 1.2, 0.0), properties={"size": [0.5, 0.5, 0.6], "mass": 3.0})
    result = run(controller, "go_round:GoRound", box)
    assert result["outcome"] == "success" and not result["decisions"]
    assert np.linalg.norm(np.subtract(result["objects"][0]["final_pose"], box.pose)[:2]) < 0.01


@pytest.mark.parametrize(("goal", "told"), [((9.0, 1.5), "off the map"), ((3.5, 0.05), "inside a wall")])
def test_a_goal_where_no_floor_is_is_refused(controller: PushController, goal: tuple[float, float], told: str) -> None:
    with pytest.raises(ShmooError, match=f"goal .* lies {told}"):
        run_episode(room(), scenario(), controller, goals=[(3.5, 1.5), goal])


def test_who_stops_elsewhere_has_not_arrived(controller: PushController) -> None:
    assert run(controller, "bad:StopsAtOnce")["outcome"] == "stopped short"


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        ("bad:Fails", ("AttributeError", "bad.py", "line 17", "nothing")),
        ("bad:Shapeless", ("u is [1, 3]",)),
        ("bad:Broken", ("not finite",)),
        ("bad:Missing", ("bad has no class or function 'Missing'",)),
        ("bad", ("give it as package.module:Name",)),
        ("gone:Policy", ("no module 'gone'",)),
        ("torn:Policy", ("no module 'nothing_like_it'",)),
    ],
)
def test_what_is_wrong_is_said(controller: PushController, policy: str, words: tuple[str, ...]) -> None:
    with pytest.raises(ShmooError) as refusal:
        run(controller, policy)
    assert all(word in str(refusal.value) for word in (policy, *words)) and "\n" not in str(refusal.value)


def test_the_command_runs_it_and_replays_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from shmoo_mjx import cli

    save_map(room(), tmp_path / "room.yaml")
    save_scenario(scenario().model_copy(update={"map": "room.yaml"}), tmp_path / "mine.yaml")

    def shmoo(*arguments: str) -> Any:
        monkeypatch.setattr(sys, "argv", ["shmoo", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code

    with_policy = ("--scenario", "mine.yaml", "--policy", "straight:Straight", "--no-video", "--out", "run", "--quiet")
    assert shmoo("navigate", *with_policy) == 0
    assert json.loads((tmp_path / "run/result.json").read_text())["policy"] == "straight:Straight"
    assert shmoo("replay", "run") == 0


def test_the_maker_is_what_the_name_says() -> None:
    assert custom.named("policy", "bad:Fails") is sys.modules["bad"].Fails
