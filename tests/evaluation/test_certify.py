"""Certificates: what they say of small scenarios, that they can be replayed, and that their times add up."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from toy import toy_scenario

from shmoo_mjx.evaluation.certify import Attempt, Certificate, certify, replay
from shmoo_mjx.evaluation.scenario_set import find_set, open_set
from shmoo_mjx.planning.maps import load_map
from shmoo_mjx.planning.paths import plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS


@cache
def toy(movable: bool) -> Certificate:
    return certify(*toy_scenario(1, movable))


@pytest.mark.slow
def test_a_light_box_in_the_only_doorway_is_pushed_through_and_a_heavy_one_blocks() -> None:
    light, heavy = toy(True), toy(False)
    assert light.round_s is None and light.pushed == (0,) and light.moves(0, 0.5)
    assert light.reference_s is not None and 10.0 < light.reference_s < 40.0
    assert light.options() == {0: light.reference_s}
    assert heavy.reference_s is None and heavy.best == () and not heavy.moves(0, 0.1) and heavy.options() == {}
    # Nothing gives way under the first attempts, so that no others are made.
    assert {a.result for a in heavy.attempts} <= {"stuck", "failed"} and all(a.steering == 0 for a in heavy.attempts)


@pytest.mark.slow
def test_no_push_is_tried_from_where_the_object_is_not_in_the_way() -> None:
    """From the goal's side of a doorway every push would seem to free the way: the robot has gone round already."""
    grid, scenario = toy_scenario(2, False)
    found = certify(grid, scenario)
    assert found.round_s == found.reference_s and found.best == () and found.options() == {None: found.round_s}
    for attempt in found.attempts:
        here, past = (plan_path(grid, attempt.start, scenario.goal, [], robot_radius=ROBOT_RADIUS), attempt.start[0])
        assert here is not None and past < 3.0


def test_what_was_not_tried_counts_as_it_was_drawn() -> None:
    assert toy(False).moves(7, 0.3, True) and not toy(False).moves(7, 0.3)


def attempt(index: int, result: str, seconds: float, after: int | None = None) -> Attempt:
    given = {"object": index, "face": 0, "lateral": 0.0, "steering": 0.0, "start": (0.0, 0.0, 0.0)}
    return Attempt(**given, after=after, result=result, progress=0.5, seconds=seconds)  # type: ignore[arg-type]


def test_a_chain_counts_for_the_object_that_is_pushed_first() -> None:
    tried = (attempt(0, "passed", 20.0), attempt(1, "free", 45.0, 0), attempt(2, "free", 50.0))
    found = Certificate(attempts=tried, round_s=60.0, reference_s=45.0, best=(0, 1))
    assert found.options() == {None: 60.0, 0: 45.0, 2: 50.0} and found.pushed == (0, 1)


@pytest.mark.slow
def test_replaying_gives_the_same_again() -> None:
    again = replay(*toy_scenario(1, True), toy(True))
    assert [a.result for a in again] == ["free"]
    assert again[-1].seconds == pytest.approx(toy(True).reference_s, abs=1.0)


@pytest.mark.slow
def test_certificates_of_the_arena_are_replayed(tmp_path: Path) -> None:
    places, _ = open_set(find_set(Path("arena")), tmp_path)
    assert places.entries is not None
    entries = places.entries
    pushed = [key for key, found in entries.items() if found.certificate is not None and found.certificate.best][::8]
    done = []
    for key in pushed:
        found = entries[key]
        assert found.certificate is not None and found.certificate.reference_s is not None
        again = replay(load_map(places.maps[key.rpartition("-")[0]]), found.scenario, found.certificate)
        done.append(again[-1].result == "free" and abs(again[-1].seconds - found.certificate.reference_s) < 2.0)
    assert done and np.mean(done) == 1.0, dict(zip(pushed, done, strict=True))
