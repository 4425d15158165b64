"""Expected times of options: outcomes that are made up, in a corridor and in a wide room."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shmoo_mjx.behavior.belief import ObjectBelief
from shmoo_mjx.behavior.push_options import AWAY, Push, describe_options, option_list, predict_pushes, rank_pushes
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid, distance_field
from shmoo_mjx.planning.paths import Path
from shmoo_mjx.planning.reach import STEPS, Options, Outcomes
from shmoo_mjx.types import DT

HALF = (0.3, 0.45)
SAMPLES = 4
KNOWN = ObjectBelief(np.array([3.0, 1.0, 0.0]), HALF)
PATH = Path(np.array([[1.0, 1.0], [5.0, 1.0], [8.0, 1.0]]), 7.0)


class Moves:
    """A foresight in which the object follows its push at a speed [m/s], in the first samples not at all."""

    def __init__(self, speed: float, stuck: int = 0) -> None:
        self.speed, self.stuck = speed, stuck

    def __call__(self, adapt: Any, kind: Any, pose: Any, half: Any, options: Options, seed: int) -> Outcomes:
        ahead = np.asarray(options.goal)[:, :2] - pose[:2]
        ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        way = self.speed * DT * np.arange(1, STEPS + 1)[:, None] * np.ones((len(ahead), SAMPLES, 1, 1))
        way[:, : self.stuck] = 0.0
        place = pose[:2] + way * ahead[:, None, None]
        yaw = np.full((*place.shape[:3], 1), pose[2])
        robot = place - 0.75 * ahead[:, None, None]
        return Outcomes(np.concatenate([place, yaw], -1), np.concatenate([robot, yaw], -1))


def room(width: float) -> Any:
    """A corridor along x of this width [m], its middle at y = 1, that opens to twice the width at x = 6."""
    cells = np.full((160, 200), OCCUPIED, np.int8)
    y = -3.0 + 0.05 * (np.arange(160) + 0.5)
    cells[np.abs(y - 1.0) < width / 2, 5:195] = 0
    cells[np.abs(y - 1.0) < width, 120:195] = 0
    return distance_field(OccupancyGrid(cells, 0.05, (0.0, -3.0, 0.0)))


def pushed(foresight: Any, width: float, sides: tuple[int, ...] = (0, 1, 2, 3)) -> dict[int, Push]:
    """The best push on each side, by its side: 4 s to the hands' contact, 10 s behind it, 60 s without a push."""
    found = predict_pushes(foresight, KNOWN, PATH, clearance=room(width), sides=sides, places={})
    return {
        p.side: p for p in rank_pushes(found, walks=dict.fromkeys(sides, 4.0), failed=(), rest=10.0, otherwise=60.0)
    }


def share(push: Push) -> float:
    return float(np.isfinite(push.free).mean())


def test_in_a_wide_room_a_push_across_frees_the_path_soonest() -> None:
    found = pushed(Moves(0.25), 2.0)
    assert share(found[1]) == share(found[3]) == 1.0
    # The robot passes between wall and object once 0.64 m are free; 0.55 m are.
    assert found[1].free.max() < 4.0
    assert abs(found[1].goal[1] - 1.0) > 0.1


def test_in_a_corridor_only_a_push_along_it_does() -> None:
    found = pushed(Moves(0.4), 1.2)
    assert share(found[1]) == share(found[3]) == 0.0
    assert share(found[0]) == 1.0
    assert 6.0 < found[0].free.min() <= found[0].free.max() < 12.0
    assert found[0].goal[0] > 5.0
    assert found[0].seconds < min(found[1].seconds, found[3].seconds)


def test_where_it_still_stands_on_the_path_far_away_the_path_is_not_free() -> None:
    """The corridor goes on for longer than the push, and so does the path."""
    cells = np.full((160, 400), OCCUPIED, np.int8)
    cells[68:92, 5:395] = 0
    long = distance_field(OccupancyGrid(cells, 0.05, (0.0, -3.0, 0.0)))
    path = Path(np.array([[1.0, 1.0], [18.0, 1.0]]), 17.0)
    found = predict_pushes(Moves(0.4), KNOWN, path, clearance=long, sides=(0,), places={})
    assert not any(np.isfinite(push.free).any() for push in found)


def test_a_way_round_that_is_near_does_not_count_as_freed_by_a_push() -> None:
    """Two openings side by side in a wall, 2 m apart: what does not move closes one of them."""
    cells = np.zeros((160, 200), np.int8)
    cells[:, 58:62] = OCCUPIED
    cells[70:90, 58:62] = cells[110:130, 58:62] = 0
    field = distance_field(OccupancyGrid(cells, 0.05, (0.0, -3.0, 0.0)))
    found = predict_pushes(Moves(0.0), KNOWN, PATH, clearance=field, sides=(0, 1, 2, 3), places={})
    assert not any(np.isfinite(push.free).any() for push in found)


def weighed(free: list[list[float]], sides: tuple[int, ...], failed: tuple[int, ...] = (), **times: float) -> Any:
    """Expected times of pushes whose path is free after so many seconds in each sample."""
    nowhere = np.zeros(3)
    found = [Push(side, nowhere, np.array(t), np.zeros((len(t), 0, 2))) for side, t in zip(sides, free, strict=True)]
    given = {"rest": 10.0, "otherwise": 60.0} | times
    return {p.side: p for p in rank_pushes(found, walks=dict.fromkeys(sides, 4.0), failed=failed, **given)}


@given(st.lists(st.one_of(st.floats(1.0, 12.0), st.just(np.inf)), min_size=4, max_size=4), st.floats(20.0, 600.0))
def test_more_success_never_takes_more_time_and_a_failure_costs_what_follows(
    free: list[float], otherwise: float
) -> None:
    one, sure = (weighed([f], (0,), otherwise=otherwise)[0] for f in (free, [1.0] * 4))
    never = weighed([[np.inf] * 4], (0,), otherwise=otherwise)[0]
    assert sure.seconds - 1e-6 <= one.seconds <= never.seconds + 1e-6
    assert 0.0 < never.probability <= one.probability <= sure.probability < 1.0
    later = weighed([free], (0,), otherwise=otherwise + 10.0)[0]
    assert later.seconds - one.seconds == pytest.approx(10.0 * (1.0 - one.probability))


def test_what_fails_on_one_side_may_still_succeed_on_another() -> None:
    """Two sides, each free in half of the samples: in the same ones, or each where the other is not."""
    same = weighed([[2.0, 2.0, np.inf, np.inf]] * 2, (0, 1), otherwise=600.0)
    other = weighed([[2.0, 2.0, np.inf, np.inf], [np.inf, np.inf, 2.0, 2.0]], (0, 1), otherwise=600.0)
    alone = weighed([[2.0, 2.0, np.inf, np.inf]], (0,), otherwise=600.0)
    assert other[0].seconds < same[0].seconds - 100.0
    assert same[0].seconds <= alone[0].seconds


def test_options_are_told_with_their_times_and_probabilities() -> None:
    push = weighed([[2.0, 2.0, 2.0, np.inf]], (0,))[0]
    assert push.works == pytest.approx(4.0 + AWAY + 2.0 + 10.0, abs=0.5) and push.works < push.seconds
    said = describe_options((push,), 31.0)
    assert f"push from behind {push.works:.0f} s ({push.probability:.0%}, {push.seconds:.0f} s on average)" in said
    assert said.endswith("go round 31 s")
    assert describe_options((push,), None).endswith(f"{push.works:.0f} s ({push.probability:.0%}); no way round")
    pushed, detour = option_list((push,), 31.0)
    assert pushed == ("push from behind", push.works, push.seconds, push.probability)
    assert detour == ("go round", 31.0, 31.0, 1.0) and option_list((push,), None) == (pushed,)


def test_a_side_that_has_failed_is_trusted_less_each_time() -> None:
    times = [weighed([[2.0] * 4], (0,), (0,) * n, otherwise=600.0)[0].seconds for n in range(5)]
    assert times == sorted(times) and times[0] < 60.0 < times[-1]
    assert weighed([[2.0] * 4], (0,), (1, 1), otherwise=600.0)[0].seconds == pytest.approx(times[0])
    assert times[-1] > 600.0  # then it is given up


def test_roll_outs_that_diverge_count_as_failures() -> None:
    class Diverges(Moves):
        def __call__(self, *args: Any, **kwargs: Any) -> Outcomes:
            found = super().__call__(*args, **kwargs)
            found.object_pose[:, 0] = np.nan
            return found

    assert share(pushed(Diverges(0.25), 2.0, (1,))[1]) == 0.75
