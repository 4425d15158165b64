"""The balancing robot: stands, follows, survives pushes, and holds its hands where it is told."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from shmoo_mjx.base.assets import asset
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH, hand_targets
from shmoo_mjx.plant import lowlevel
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.robot import readout, shmoobot
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.plant.trials import command, drive


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene()


@pytest.fixture(scope="module")
def single(scene: Scene) -> Iterator[MujocoEngine]:
    engine = MujocoEngine([scene])
    yield engine
    engine.close()


def test_stands_ten_seconds_with_sensor_noise(single: MujocoEngine) -> None:
    noise = (np.random.default_rng(0), 0.01, 0.01)
    track, fallen = drive(single, 10.0, station=0.8, sensor_noise=noise)
    assert not fallen.any()
    assert np.hypot(*track.robot_pose[:, 0, :2].T).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_stands_a_minute_with_sensor_noise(single: MujocoEngine, seed: int) -> None:
    noise = (np.random.default_rng(seed), 0.01, 0.01)
    track, fallen = drive(single, 60.0, station=0.8, sensor_noise=noise)
    assert not fallen.any()
    assert np.hypot(*track.robot_pose[:, 0, :2].T).max() < 0.1


def test_starts_in_balance(single: MujocoEngine) -> None:
    """With no lean command and no outer loop nothing holds the place; a start in balance keeps the robot near it."""
    world = single.init()
    for _ in range(100):
        world, seen = single.step(world, command(1))
    assert np.hypot(*seen.robot_pose[0, :2]) < 0.1
    np.testing.assert_allclose(seen.hands, single.observe(single.init()).hands, atol=0.01)


def test_velocity_step(single: MujocoEngine) -> None:
    track, _ = drive(single, 5.0, lambda time: (0.5, 0.0))
    speed = track.robot_twist[:, 0, 0]
    assert 0.6 < (np.argmax(speed > 0.45) + 1) * 0.1 < 1.5
    assert speed.max() < 1.15 * 0.5
    assert speed[-1] == pytest.approx(0.5, abs=0.02)
    assert np.abs(track.robot_pose[:, 0, 1]).max() < 0.01


def test_lean_command(single: MujocoEngine) -> None:
    wanted = np.deg2rad(5.0)
    world = single.init()
    leans = []
    for _ in range(50):
        world, seen = single.step(world, command(1, (wanted, 0.0)), 0.02)
        leans.append(seen.lean[0, 0])
    assert np.argmax(np.array(leans) > 0.9 * wanted) * 0.02 < 0.8
    assert max(leans) < 1.1 * wanted
    assert leans[-1] == pytest.approx(wanted, rel=0.05)


def test_survives_pushes_from_sixteen_sides(scene: Scene) -> None:
    engine = MujocoEngine([scene] * 16)
    angle = np.arange(16) * np.pi / 8
    push = np.zeros((16, 6))
    push[:, 0], push[:, 1] = 20 * np.cos(angle), 20 * np.sin(angle)
    track, fallen = drive(engine, 3.0, station=0.8, push=lambda time: push if 0.95 < time < 1.45 else None)
    engine.close()
    assert not fallen.any()
    excursion = np.hypot(*np.moveaxis(track.robot_pose[9:, :, :2] - track.robot_pose[9, :, :2], -1, 0)).max(axis=0)
    # The real robot moves about 0.2 m.
    assert excursion.min() > 0.1 and excursion.max() < 0.3


def test_pivots_in_place(single: MujocoEngine) -> None:
    track, _ = drive(single, 4.0, station=0.8, yaw=1.5)
    assert track.robot_pose[-1, 0, 2] == pytest.approx(1.5, abs=0.05)
    assert np.abs(track.robot_pose[:, 0, :2]).max() < 0.05


def test_com_feed_forward_keeps_the_robot_in_place(scene: Scene) -> None:
    """With the feed-forward off, reaching out makes the robot drift visibly further."""

    def drift(share: float) -> float:
        engine = MujocoEngine([scene], lowlevel.Gains(com_feed_forward=share))
        world = engine.init()
        start = 0.0
        for i in range(40):
            reach, height = (REACH, HAND_HEIGHT) if i >= 10 else (TUCKED_REACH, TUCKED_HEIGHT)
            world, seen = engine.step(world, command(1, reach=reach, hand_height=height))
            start = float(seen.robot_pose[0, 0]) if i == 9 else start
        assert not engine.fallen(world).any()
        engine.close()
        return abs(float(seen.robot_pose[0, 0]) - start)

    assert drift(0.0) > 2 * drift(1.0)


@pytest.mark.parametrize("gamma", [-0.3, 0.0, 0.3])
def test_hands_reach_their_targets_unloaded(single: MujocoEngine, gamma: float) -> None:
    world = single.init()
    for _ in range(20):
        world, seen = single.step(world, command(1, gamma=gamma, reach=REACH, hand_height=HAND_HEIGHT))
    np.testing.assert_allclose(seen.hands[0, :, :2], hand_targets(np.array(gamma), np.array(REACH)), atol=0.01)
    np.testing.assert_allclose(seen.hands[0, :, 2], HAND_HEIGHT, atol=0.01)


def test_hands_show_the_set_stiffness() -> None:
    """With the torso clamped, 10 N on one hand displaces it by F / K in the direction of the force."""
    gains = lowlevel.Gains()
    spec = mujoco.MjSpec.from_file(str(asset("models_xml/shmoobot.xml")))
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1="torso",
        data=[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0],
        solref=[0.004, 1],
        solimp=[0.9999, 0.9999, 0.001, 0.5, 2],
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[11:17] = np.tile([0.0, 1.0, -1.8], 2)
    state = lowlevel.init(np, (), REACH, 0.5)
    wanted = command(1, reach=REACH, hand_height=0.5)
    wanted = type(wanted)(*(field[0] for field in wanted))
    rest = None
    for force in ((0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10)):
        for _ in range(750):
            state, torque = lowlevel.control(
                shmoobot(), gains, state, readout(data.qpos, data.qvel), command=wanted, dt=0.002
            )
            torque[:3] = 0.0
            data.ctrl[:] = torque
            data.xfrc_applied[model.body("left_hand").id, :3] = force
            mujoco.mj_step(model, data)
        place = data.site("left_hand").xpos.copy()
        rest = place if rest is None else rest
        np.testing.assert_allclose(gains.hand_stiffness * (place - rest), force, atol=1.0)


def _in_front(gap: float, **properties: object) -> Scene:
    condition = draw_condition("box", 0, {"size": (0.6, 0.6, 0.6), "payload": 0.0, **properties})
    return build_scene([(condition, (REACH + 0.04 + gap + 0.3, 0.0, 0.0))])


def test_pushes_forty_newtons_steadily() -> None:
    engine = MujocoEngine([_in_front(0.03, mass=200.0, friction=1.0)])
    world = engine.init()
    forces = []
    for _ in range(70):
        world, seen = engine.step(world, command(1, (0.11, 0.0), reach=REACH, hand_height=HAND_HEIGHT))
        forces.append(seen.wrench[0, 0, 0])
    engine.close()
    assert min(forces[50:]) > 40 and np.std(forces[50:]) < 2
    assert np.abs(seen.lean).max() < 0.2


@pytest.mark.parametrize("gamma", [-0.3, 0.3])
def test_steering_turns_a_pushed_box(gamma: float) -> None:
    """Positive gamma moves the left hand forward and turns the object to the right (Sec. III)."""
    engine = MujocoEngine([_in_front(0.03, mass=5.0, friction=0.35)])
    world = engine.init()
    for i in range(40):
        lean = 0.05 if i > 5 else 0.0
        world, seen = engine.step(world, command(1, (lean, 0.0), gamma=gamma, reach=REACH, hand_height=HAND_HEIGHT))
    engine.close()
    assert -np.sign(gamma) * seen.object_pose[0, 0, 2] > 0.05


def test_control_is_the_same_on_numpy_and_jax() -> None:
    import jax
    import jax.numpy as jnp

    rng = np.random.default_rng(1)
    scene = build_scene()
    qpos = scene.qpos0 + 0.05 * rng.normal(size=scene.qpos0.shape)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos[7:11] /= np.linalg.norm(qpos[7:11])
    qvel = 0.3 * rng.normal(size=15)
    wanted = command(1, (0.05, -0.02), gamma=0.2, yaw=0.3, reach=REACH, hand_height=HAND_HEIGHT)
    wanted = type(wanted)(*(field[0] for field in wanted))
    state = lowlevel.init(np, (), TUCKED_REACH, TUCKED_HEIGHT)
    gains = lowlevel.Gains()
    plain, torque = lowlevel.control(shmoobot(), gains, state, readout(qpos, qvel), command=wanted, dt=0.002)
    lift = lambda tree: jax.tree.map(jnp.asarray, tree)  # noqa: E731
    traced, jax_torque = lowlevel.control(
        shmoobot(), gains, lift(state), lift(readout(qpos, qvel)), command=lift(wanted), dt=0.002
    )
    np.testing.assert_allclose(np.asarray(jax_torque), torque, rtol=1e-4, atol=1e-3)
    for a, b in zip(plain, traced, strict=True):
        np.testing.assert_allclose(np.asarray(b), a, rtol=1e-4, atol=1e-4)


def test_velocity_to_lean_is_bounded() -> None:
    gains = lowlevel.Gains()
    lean = lowlevel.velocity_to_lean(gains, np.zeros(2), np.zeros(2), np.array([100.0, -100.0]))
    np.testing.assert_allclose(lean, [gains.lean_limit, -gains.lean_limit])


def test_heading_error_takes_the_short_way(single: MujocoEngine) -> None:
    """From heading 0, a command of 1.9 pi turns right by 0.1 pi, not left."""
    track, _ = drive(single, 2.0, station=0.8, yaw=1.9 * np.pi)
    assert float(se2.wrap(track.robot_pose[-1, 0, 2])) < 0
    assert shmoobot().radius < 0.2
