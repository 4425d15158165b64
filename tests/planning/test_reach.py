"""Where pushes are predicted to lead: by objects whose dynamics are known, and against the simulator."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.behavior.push_options import make_options
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.learning import contact_prior
from shmoo_mjx.learning.estimate import ObjectEstimate
from shmoo_mjx.learning.weights import load_weights, prior_state
from shmoo_mjx.planning.reach import (
    SAMPLES,
    STEPS,
    Outcomes,
    contact_foresight,
    foresight_of,
    goal_ahead,
    median_parameters,
    probability_to_come,
    progress,
)
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import draw_condition

HALF = (0.3, 0.3)
NOWHERE = np.zeros(3)


@cache
def controller() -> PushController:
    return PushController(load_weights())


def known(condition: Condition) -> ObjectEstimate:
    """The posterior of who knows an object exactly."""
    told = jnp.asarray(contact_prior.parameters_of(condition), jnp.float32)
    prior = prior_state(controller().weights)
    assert isinstance(prior, ObjectEstimate)
    return prior._replace(parameters=jnp.broadcast_to(told, prior.parameters.shape))


def outcomes(condition: Condition | None, kind: str | None = None) -> Outcomes:
    """Of all options with an object whose dynamics are known, or by its looks."""
    foresight = foresight_of(controller())
    assert foresight is not None
    adapt = None if condition is None else known(condition)
    half = HALF if condition is None else condition.half_extents
    options = make_options(NOWHERE, half, np.zeros((8, 3))).options
    return foresight(adapt, kind, NOWHERE, half, options=options, seed=0)


def straight(found: Outcomes) -> np.ndarray:
    """Distance along x that the object goes when it is pushed straight on from behind ``[S, T]``."""
    return found.object_pose[2, :, :, 0]


@pytest.mark.slow
def test_what_is_light_goes_as_fast_as_the_robot_and_what_is_heavy_stays() -> None:
    light = straight(outcomes(draw_condition("box", 3, {"mass": 4.0, "friction": 0.3})))
    heavy = straight(outcomes(draw_condition("box", 3, {"mass": 60.0, "friction": 0.6})))
    assert light.shape == (SAMPLES, STEPS)
    assert np.all((light[:, -1] > 1.0) & (light[:, -1] < 4.5))
    assert np.all(heavy[:, -1] < 0.1)


def test_before_a_touch_looks_decide() -> None:
    """Boxes may be too heavy, carts without brakes hardly are: what may happen differs from sample to sample."""
    box, cart = straight(outcomes(None, "box"))[:, -1], straight(outcomes(None, "cart"))[:, -1]
    assert box.min() < 0.1 and box.max() > 1.0
    assert np.mean(cart > 0.5) > np.mean(box > 0.5)


def test_the_same_seed_foresees_the_same() -> None:
    box = draw_condition("box", 3, {"mass": 8.0})
    for one, other in zip(outcomes(box), outcomes(box), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_wheelchair_pushed_on_its_side_turns_about_its_axle_and_does_not_slide() -> None:
    chair = draw_condition("wheelchair", 3, {"payload": 20.0, "locked": [False] * 4})
    found = outcomes(chair)
    sides = make_options(NOWHERE, chair.half_extents, np.zeros((8, 3)))
    onto_left = int(np.flatnonzero((sides.side == 1) & np.isclose(sides.options.goal[:, 0], 0.0, atol=1e-3))[0])
    pose = found.object_pose[onto_left]
    assert np.median(np.abs(pose[:, -1, 2])) > 0.4
    assert np.median(np.abs(pose[:, 40, 1])) < 0.5


def test_a_push_begins_with_hands_at_the_face() -> None:
    found = outcomes(draw_condition("box", 3, {"mass": 8.0}))
    first = found.robot_pose[2, :, 0]
    assert np.all(np.abs(np.linalg.norm(first[:, :2], axis=1) - np.linalg.norm(first[0, :2])) < 0.02)
    assert np.isfinite(jax.tree.leaves(found)[0][:, :, :30]).mean() > 0.95


def arc(start: np.ndarray, face: np.ndarray, length: float, turn: float) -> np.ndarray:
    """Poses ``[50, 3]`` of an object that comes ``length`` along an arc on which it turns by ``turn``."""
    yaw = np.linspace(0.0, turn, 51)[1:]
    radius = length / turn
    local = np.stack([radius * np.sin(yaw), radius * (1.0 - np.cos(yaw)), yaw], axis=-1)
    along = np.array([0.0, 0.0, face[2]])
    return se2.compose(se2.compose(start, along), se2.compose(local, -along))


@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize("turn", [1e-6, 0.5, -3.0])
def test_progress_is_the_way_along_the_push_whichever_way_that_turns(side: int, turn: float) -> None:
    start, face = np.array([1.0, -2.0, 2.5]), faces_of((0.4, 0.3))[side]
    way = progress(arc(start, face, 0.8, turn), start, face)
    np.testing.assert_allclose(way, np.linspace(0.0, 0.8, 51)[1:], rtol=2e-3)
    backwards = progress(arc(start, face, -0.8, turn), start, face)
    np.testing.assert_allclose(backwards, -way, rtol=1e-2)


def test_the_probability_is_the_share_of_samples_that_come_so_far_before_they_turn() -> None:
    start, face = np.array([0.5, 0.0, -3.0]), faces_of((0.4, 0.3))[1]
    lost = np.where(np.arange(50)[:, None] < 20, arc(start, face, 1.0, 1e-6), np.nan)
    samples = np.stack([arc(start, face, way, turn) for way, turn in ((1.0, 0.1), (0.5, 0.1), (1.0, 2.0))] + [lost])
    assert probability_to_come(samples, start, face, distance=0.3) == 1.0
    assert probability_to_come(samples, start, face, distance=0.45) == 0.75
    assert probability_to_come(samples, start, face, distance=0.8) == 0.5
    assert probability_to_come(samples, start, face, distance=0.8, turn=1.0) == 0.25
    options = np.stack([samples, samples[::-1]])
    np.testing.assert_array_equal(probability_to_come(options, start, face, distance=0.8), [0.5, 0.5])


def test_a_goal_ahead_is_at_the_end_of_an_arc_that_begins_along_the_push() -> None:
    pose, face = np.array([1.0, 2.0, 0.5]), faces_of((0.4, 0.3))[1]
    straight, left = goal_ahead(pose, face), goal_ahead(pose, face, 0.2)
    off = straight[:2] - pose[:2]
    np.testing.assert_allclose([np.arctan2(off[1], off[0]), straight[2]], [0.5 + np.pi / 2, 0.5])
    end = arc(pose, face, 2.5 * 0.2 / np.sin(0.2), 0.4)[-1]
    np.testing.assert_allclose(left, end, atol=1e-6)


def test_a_light_box_is_said_to_come_and_a_heavy_one_not() -> None:
    foresight, face = foresight_of(controller()), faces_of(HALF)[0]
    assert foresight is not None
    light, heavy = (
        foresight.probability_to_move(known(draw_condition("box", 3, of)), None, NOWHERE, HALF, face=face, distance=0.3)
        for of in ({"mass": 4.0, "friction": 0.3}, {"mass": 60.0, "friction": 0.6})
    )
    assert light > 0.95 and heavy < 0.05


def test_the_middle_is_that_of_what_can_be_moved() -> None:
    light, heavy = (known(draw_condition("box", 3, of)) for of in ({"mass": 4.0}, {"mass": 60.0, "friction": 0.6}))
    mixed = heavy._replace(parameters=jnp.concatenate([light.parameters[:300], heavy.parameters[300:]]))
    np.testing.assert_array_equal(median_parameters(mixed), light.parameters[0])
    np.testing.assert_array_equal(median_parameters(heavy), heavy.parameters[0])


def test_pushers_without_the_contact_model_are_given_the_shipped_one() -> None:
    shipped = contact_foresight(object(), PushConfig())
    assert contact_foresight(None, PushConfig()) is shipped
    assert contact_foresight(controller(), PushConfig()) is foresight_of(controller()) is not shipped
