"""The skills: one step of each, on NumPy and JAX arrays alike."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.behavior.skills import approach, batched, contact, hold, push, retreat
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.geometry.hands import CONTACT_FORCE, REACH, TUCKED_REACH, touches
from shmoo_mjx.types import DT

HALF = (0.25, 0.3)
FACE = faces_of(HALF)[0]
OBJECT = np.array([1.0, 0.5, 0.2])


def ahead(way: float) -> np.ndarray:
    """The object's pose ``way`` metres on along the push."""
    return OBJECT + np.array([way * np.cos(0.2), way * np.sin(0.2), 0.0])


def object_obs(
    gap: float, force: float = 0.0, speed: float = 0.0, lateral: float = 0.0, moved: float = 0.0
) -> ObjectObservation:
    """The robot before the rear face, ``gap`` metres between it and the extended hands."""
    robot = stand_off(OBJECT, FACE, gap, lateral)
    twist = speed * np.array([np.cos(0.2), np.sin(0.2), 0.0])
    zero = np.zeros(2)
    return ObjectObservation(robot, twist, zero, zero, ahead(moved), np.zeros(3), np.array([force, 0.0, 0.0]), True)


def test_one_definition_of_contact() -> None:
    wrench = np.array([[CONTACT_FORCE + 0.1, 0.0, 9.0], [CONTACT_FORCE - 0.1, 0.0, 9.0], [np.nan, 0.0, 0.0]])
    assert touches(wrench).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("gap", "force", "moved", "over"),
    [(0.02, 5.0, 0.0, True), (0.02, 0.5, 0.0, False), (0.12, 5.0, 0.0, False), (0.02, 0.0, 0.05, True)],
)
def test_contact_is_what_is_felt_or_gives_way_near_the_face(gap: float, force: float, moved: float, over: bool) -> None:
    """Arms that unfold far from the face feel their own mass."""
    state = contact.init(object_obs(gap))
    _, move = contact.step(state, object_obs(gap, force, moved=moved), FACE)
    assert bool(move.over) is over
    assert bool(move.command.u[0] > 0.01) is not over, "it creeps on until it touches"


def test_contact_fails_beside_the_face_and_far_from_it() -> None:
    for at in (object_obs(0.05, lateral=0.4), object_obs(0.6)):
        assert bool(contact.step(contact.init(at), at, FACE)[1].failed)


def test_a_retreat_draws_the_hands_back_then_folds_the_arms_and_ends_at_rest() -> None:
    near, clear = object_obs(0.0), object_obs(0.1)
    first = retreat.step(near, FACE, folded=False)
    assert first.command.u[0] < 0 and first.command.reach == pytest.approx(REACH - retreat.WITHDRAW)
    assert not first.over
    away = retreat.step(clear, FACE, folded=False)
    assert away.command.reach == TUCKED_REACH and not away.over
    assert retreat.step(clear, FACE, folded=False, room=False).command.reach > TUCKED_REACH
    assert retreat.step(clear, FACE, folded=True).over
    assert not retreat.step(object_obs(0.1, speed=0.2), FACE, folded=True).over


def test_arms_extend_at_the_stand_off_pose_only_and_where_they_have_room() -> None:
    state, path = approach.init(0.0, approach.CONTACT_GAP), {"lean": np.zeros(2), "yaw": 0.0, "remaining": 0.0}
    at, far = object_obs(approach.CONTACT_GAP), object_obs(0.6)
    assert approach.step(state, 1.0, far, FACE, **path)[0].extended_at is None
    assert approach.step(state, 1.0, at, FACE, **path, room=False)[0].extended_at is None
    reached, move = approach.step(state, 1.0, at, FACE, **path)
    assert reached.extended_at == 1.0 and move.command.reach == REACH and not move.over
    assert approach.step(reached, 2.2, at, FACE, **path)[1].over
    assert approach.step(state, 31.0, far, FACE, **path)[1].failed


def test_an_approach_looks_at_the_object_once_it_is_near() -> None:
    state, near = approach.init(0.0, 0.12), object_obs(0.5, lateral=0.5)
    _, move = approach.step(state, 1.0, near, FACE, lean=np.zeros(2), yaw=2.0, remaining=3.0)
    bearing = np.arctan2(*(OBJECT[:2] - near.robot_pose[:2])[::-1])
    assert float(move.command.yaw) == pytest.approx(bearing)


@given(st.floats(-0.05, 0.3), st.floats(0.0, 20.0), st.floats(-0.3, 0.3), st.floats(-0.35, 0.35))
@settings(max_examples=20, deadline=None)
def test_numpy_and_jax_agree(gap: float, force: float, speed: float, lateral: float) -> None:
    now = object_obs(gap, force, speed, lateral)
    begun = contact.init(object_obs(gap))
    moves = (contact.step(begun, now, FACE)[1], retreat.step(now, FACE, folded=np.bool_(False)))
    as_jax = jax.tree.map(jnp.asarray, (begun, now, FACE))
    same = (contact.step(*as_jax)[1], retreat.step(*as_jax[1:], folded=jnp.bool_(False)))
    for one, other in zip(moves, same, strict=True):
        for a, b in zip(jax.tree.leaves(one.command), jax.tree.leaves(other.command), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-4)


class _Adapt(NamedTuple):
    adapt: Any = None


class _Pusher:
    """Leans a little, and may find no roll-out."""

    ok = True

    def init(
        self, now: ObjectObservation, face: Any, half_extents: Any, key: Any, *, adapt: Any = None, kind: Any = None
    ) -> _Adapt:
        return _Adapt(adapt)

    def step(self, state: _Adapt, now: ObjectObservation, **task: Any) -> tuple[np.ndarray, _Adapt, Any]:
        return np.array([0.1, 0.0, 0.0]), state, type("Plan", (), {"ok": self.ok})


def pushed(poses: list[float], force: float = 10.0) -> tuple[push.PushState, Any]:
    pusher = _Pusher()
    state = push.init(pusher, 0.0, object_obs(0.0), FACE, half_extents=HALF, key=None, adapt=None)
    command = None
    for moved in poses:
        now = object_obs(0.0, force, moved=moved)
        state, command = push.step(
            pusher, state, now, FACE, last_u=np.zeros(3), goal=OBJECT, clearance=None, half_extents=HALF
        )  # type: ignore[arg-type]
    return state, command


def test_a_push_keeps_what_it_felt_and_how_the_object_moved() -> None:
    state, _ = pushed([0.0, 0.01, 0.03])
    assert state.contact_time == pytest.approx(3 * DT) and state.since_contact == 0.0
    assert state.moved(ahead(0.3)) == pytest.approx(0.3)
    assert state.travelled(1.0) is None
    steady, rocking = (pushed(way)[0] for way in ([0.0, 0.01, 0.02, 0.03], [0.0, 0.06, 0.0, 0.06]))
    assert steady.travelled(0.4) == pytest.approx(0.04, abs=1e-6)
    assert rocking.travelled(0.4) == pytest.approx(0.0, abs=1e-6)
    lost, _ = pushed([0.0, 0.0], force=1.0)
    assert lost.contact_time == 0.0 and lost.since_contact == pytest.approx(2 * DT)


def test_without_a_finite_roll_out_a_push_stands_still() -> None:
    _Pusher.ok = False
    try:
        state, command = pushed([0.0])
    finally:
        _Pusher.ok = True
    assert not state.ok and abs(command.u[0]) < 1e-9


def test_letting_go_waits_for_the_goal_to_be_in_reach_and_in_coasting_distance() -> None:
    goal = ahead(0.2)
    for coast, let_go in ((0.05, False), (0.19, True)):
        coasts, decided = np.zeros(5), False
        for _ in range(5):
            coasts, left, decided = push.lets_go(ahead(coast), coasts, object_pose=OBJECT, face=FACE, goal=goal)
        assert bool(decided) is let_go and left == pytest.approx(0.2)


def test_a_command_of_one_world_becomes_a_batch_of_one() -> None:
    command = batched(hold(object_obs(0.5)))
    assert command.u.shape == (1, 3) and command.yaw.shape == (1,) and command.u.dtype == float
