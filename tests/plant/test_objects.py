"""Conditions: reproducible, printable, checked; and objects that move as their properties say."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.trials import object_alone, pushed, release, settled

G = 9.81
FREE = {"locked": (False,) * 4}


def test_condition_is_the_same_on_every_machine() -> None:
    found = {(family, seed): draw_condition(family, seed).fingerprint() for family in FAMILIES for seed in (0, 100_000)}
    assert found == {
        ("box", 0): "f0906fbe212a2bc0",
        ("box", 100_000): "4d4a40a22d75a557",
        ("cart", 0): "caef6c70731e3057",
        ("cart", 100_000): "3001500f59b45606",
        ("wheelchair", 0): "1adad17db8b8f58d",
        ("wheelchair", 100_000): "400a88bb1c94f737",
    }


@pytest.mark.parametrize("family", FAMILIES)
def test_condition_survives_json_and_prints(family: str) -> None:
    for seed in range(50):
        condition = draw_condition(family, seed)
        again = Condition.from_dict(json.loads(json.dumps(condition.to_dict())))
        assert again == condition and again.fingerprint() == condition.fingerprint()
        text = condition.describe()
        assert family in text and f"{condition.mass:.1f} kg" in text
        assert ("locked" in text) == any(condition.locked)
    assert draw_condition(family, 1).fingerprint() != draw_condition(family, 2).fingerprint()


@pytest.mark.parametrize(
    ("family", "properties", "words"),
    [
        ("sofa", {}, ("sofa", "box, cart, wheelchair")),
        ("box", {"colour": 1}, ("colour", "mass")),
        ("box", {"mass": -1.0}, ("mass", "-1.0")),
        ("box", {"mass": float("nan")}, ("mass",)),
        ("cart", {"locked": (True,)}, ("locked", "4 entries")),
        ("box", {"size": (0.0, 1.0, 1.0)}, ("size",)),
    ],
)
def test_bad_input_is_named(family: str, properties: dict, words: tuple[str, ...]) -> None:
    with pytest.raises(ShmooError) as error:
        draw_condition(family, 0, properties)
    assert all(word in str(error.value) for word in words)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("family", FAMILIES)
def test_drawn_objects_settle(family: str) -> None:
    for seed in range(6):
        model = object_alone(draw_condition(family, seed))
        data = settled(model, 1.5)
        assert not data.warning.number.any()
        assert np.abs(data.qvel[:6]).max() < 0.02
        assert abs(data.qpos[2]) < 0.02 and data.qpos[3] > 0.999


@pytest.mark.parametrize("direction", [0.0, 0.25 * np.pi, 0.4 * np.pi])
@pytest.mark.parametrize("friction", [0.25, 0.4])
def test_box_stops_after_v2_over_2_mu_g(direction: float, friction: float) -> None:
    model = object_alone(draw_condition("box", 1, {"friction": friction, "payload": 0.0}))
    data = settled(model)
    start = data.qpos[:2].copy()
    release(data, np.array([np.cos(direction), np.sin(direction), 0.0]))
    track = pushed(model, data, np.zeros(3), 1.0)
    distance = np.hypot(*(track.pose[-1, :2] - start))
    assert distance == pytest.approx(1 / (2 * friction * G), rel=0.05)


def test_box_break_away_force() -> None:
    condition = draw_condition("box", 2)
    model = object_alone(condition)
    data = settled(model)
    expected = condition.friction * condition.total_mass * G
    ramp = np.zeros((2500, 3))
    ramp[:, 0] = np.linspace(0, 1.4 * expected, 2500)
    track = pushed(model, data, ramp, 5.0, height=0.0)
    moved = np.argmax(track.twist[:, 0] > 0.01)
    assert ramp[moved, 0] == pytest.approx(expected, rel=0.10)
    assert track.pose[np.searchsorted(ramp[:, 0], 0.9 * expected), 0] < 1e-3


def _cart(seed: int, **properties: object) -> Condition:
    return draw_condition("cart", seed, FREE | {"payload_y": 0.0, "caster_angle": (0.0,) * 4} | properties)


def test_cart_rolls_straight_against_its_rolling_resistance() -> None:
    model = object_alone(_cart(0, rolling=(0.03,) * 4, swivel_friction=0.02))
    data = settled(model)
    pushed(model, data, np.array([50.0, 0.0, 0.0]), 0.6)
    track = pushed(model, data, np.zeros(3), 1.0)
    slowing = (track.twist[0, 0] - track.twist[-1, 0]) / (track.time[-1] - track.time[0])
    # Bearings and swivels add a little to C_rr g.
    assert slowing == pytest.approx(0.03 * G, rel=0.10)
    assert np.abs(track.pose[-1, 1:]).max() < 0.01


@pytest.mark.parametrize("rolling", [0.008, 0.03])
def test_rolling_resistance_does_not_fall_with_speed(rolling: float) -> None:
    model = object_alone(_cart(0, payload=35.0, rolling=(rolling,) * 4, swivel_friction=0.02))
    data = settled(model)
    data.qvel[0] = 0.15
    track = pushed(model, data, np.zeros(3), 2.0)
    speed = np.hypot(*track.twist[:, :2].T)
    began, ended = np.argmax(speed < 0.07), np.argmax(speed < 0.04)
    slowing = (speed[began] - speed[ended]) / (track.time[ended] - track.time[began])
    assert slowing == pytest.approx(rolling * G, rel=0.15)


def test_cart_turns() -> None:
    model = object_alone(_cart(0))
    track = pushed(model, settled(model), np.array([30.0, 0.0, 6.0]), 1.5, follow=True)
    assert track.pose[-1, 2] > 0.3


def test_casters_flip_on_reversal() -> None:
    # Exactly aligned casters would stand on a knife's edge.
    angles = (0.1, -0.1, 0.1, -0.1)
    model = object_alone(_cart(1, caster_angle=angles, swivel_friction=0.02))
    data = settled(model)
    pushed(model, data, np.array([-40.0, 0.0, 0.0]), 2.5)
    swivels = [angles[i] + data.joint(f"object0/wheel{i}_swivel").qpos[0] for i in range(4)]
    assert max(np.cos(swivels)) < -0.9


def test_wheelchair_resists_sideways() -> None:
    condition = draw_condition("wheelchair", 0, FREE | {"caster_angle": (0.0, 0.0), "payload_x": 0.0, "payload_y": 0.0})
    needed = []
    for axis, limit in ((0, 0.15), (1, 0.8)):
        model = object_alone(condition)
        ramp = np.zeros((1500, 3))
        ramp[:, axis] = np.linspace(0, limit * condition.total_mass * G, 1500)
        ramp[:, 2] = -0.20 * ramp[:, 1]  # through the rear axle, so that it does not turn about it
        track = pushed(model, settled(model), ramp, 3.0)
        needed.append(ramp[np.argmax(np.abs(track.twist[:, axis]) > 0.03), axis])
    assert needed[1] > 5 * needed[0]


def test_wheelchair_turns_about_its_locked_wheel() -> None:
    condition = draw_condition(
        "wheelchair", 1, {"locked": (True, False, False, False), "caster_angle": (0.0, 0.0), "payload": 20.0}
    )
    model = object_alone(condition)
    track = pushed(model, settled(model), np.array([50.0, 0.0, 0.0]), 1.5, height=0.3, follow=True)
    wheel = np.array([-0.20, condition.size[1] / 2 - 0.02])
    # The chair's sole force, at its centre, turns it left about the left rear wheel.
    assert track.pose[-1, 2] > 0.4
    slip = np.hypot(*(se2.transform_point(track.pose[-1], wheel) - wheel))
    travel = np.hypot(*(se2.transform_point(track.pose[-1], -wheel * [-1, 1]) + wheel * [-1, 1]))
    assert slip < 0.25 * travel


@pytest.mark.parametrize(("family", "casters"), [("cart", 4), ("wheelchair", 2)])
def test_locked_wheels_do_not_creep(family: str, casters: int) -> None:
    locked = (True,) * 4 if family == "cart" else (True, True, False, False)
    model = object_alone(
        draw_condition(family, 1, {"locked": locked, "caster_angle": (0.0,) * casters, "payload": 28.0})
    )
    data = settled(model)
    start = data.qpos[:2].copy()
    track = pushed(model, data, np.array([80.0, 0.0, 0.0]), 5.0, height=0.38)
    assert np.hypot(*(track.pose[-1, :2] - start)) < 0.02


def test_payload_moves_the_centre_of_rotation() -> None:
    turns = []
    for side in (-0.15, 0.0, 0.15):
        properties = {"mass": 6.0, "payload": 8.0, "payload_x": 0.0, "payload_y": side, "friction": 0.35}
        condition = draw_condition("box", 5, properties)
        model = object_alone(condition)
        force = 1.3 * condition.friction * condition.total_mass * G
        turns.append(pushed(model, settled(model), np.array([force, 0.0, 0.0]), 0.5).pose[-1, 2])
    # The heavy side stays behind: a load on the left (+y) turns the box left (+yaw).
    assert turns[0] < -0.1 and abs(turns[1]) < 0.01 and turns[2] > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_nothing_explodes_under_a_random_push(family: str) -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        model = object_alone(draw_condition(family, seed))
        data = settled(model)
        angle = rng.uniform(-np.pi, np.pi)
        force = rng.uniform(10, 60)
        wrench = np.array([force * np.cos(angle), force * np.sin(angle), rng.uniform(-5, 5)])
        pushed(model, data, wrench, 1.0, height=0.2)
        for _ in range(500):
            mujoco.mj_step(model, data)
        assert not data.warning.number.any()
        assert np.isfinite(data.qpos).all()
        assert np.abs(data.qvel).max() < 300
