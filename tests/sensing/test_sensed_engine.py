"""The engine with its senses: perfect ones are the truth, real ones late, noisy, blind behind walls, and repeatable."""

from __future__ import annotations

import dataclasses
import time

import jax
import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.perturbation import Perturbation, adjustment, draw_body
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command
from shmoo_mjx.sensing import PERFECT, REAL, SensedEngine, SensedWorld, Senses, altered, senses_named
from shmoo_mjx.types import Observation

BOX = draw_condition("box", 1, {"mass": 9.0, "payload": 0.0, "friction": 0.35})
AHEAD = (REACH + 0.04 + 0.05 + BOX.half_extents[0], 0.05, 0.2)
NOMINAL = dataclasses.replace(REAL, body=Perturbation.none(), computing=0.0)
EXACT = altered(
    NOMINAL,
    camera={"position_noise": 0.0, "yaw_noise": 0.0, "least_position_noise": 0.0, "least_yaw_noise": 0.0,
            "drop_out": 0.0, "burst": 0.0},
    odometry={"scale": 0.0, "yaw_scale": 0.0, "yaw_bias": 0.0, "walk": 0.0, "yaw_walk": 0.0, "fix_position": 0.0,
              "fix_yaw": 0.0},
)  # fmt: skip
"""Limits and delays as they are, without any error."""


def stand(worlds: int = 1) -> object:
    return command(worlds, (0.0, 0.0))


def push(senses: Senses, seed: int = 0, samples: int = 20, **given: object) -> tuple[Observation, Observation]:
    """What is reported and what is true ``[T, ...]`` while a box is pushed."""
    scene = build_scene([(BOX, AHEAD)], adjust=senses.adjust(seed))
    reports, truths = [], []
    with SensedEngine([scene], senses, seed) as engine:
        world = engine.init()
        for i in range(samples):
            lean = 0.1 if i >= 6 else 0.0
            wanted = command(1, (lean, 0.0), gamma=0.1, reach=REACH, hand_height=HAND_HEIGHT)
            world, seen = engine.step(world, wanted, **given)  # type: ignore[arg-type]
            reports.append(seen)
            truths.append(engine.true_observation(world))
        assert not engine.fallen(world)[0]
    first, second = (Observation(*(np.stack(f)[:, 0] for f in zip(*r, strict=True))) for r in (reports, truths))
    return first, second


def moved(engine: SensedEngine, world: SensedWorld, index: int, by: tuple[float, float]) -> SensedWorld:
    """Object ``index`` put elsewhere by somebody."""
    physics = world.truth.physics.copy()
    adr = 1 + int(engine.scenes[0].object_qpos[index])
    physics[:, adr : adr + 2] += by
    return world._replace(truth=world.truth._replace(physics=physics))


def test_perfect_senses_are_the_truth_and_no_slower() -> None:
    seen, _ = push(PERFECT, samples=12)
    with SensedEngine([build_scene([(BOX, AHEAD)])], PERFECT) as engine:
        bare, took = MujocoEngine([build_scene([(BOX, AHEAD)])]), {"sensed": [], "bare": []}
        for name, it in (("sensed", engine), ("bare", bare)) * 4:  # other processes slow some down: the fastest counts
            world, began = it.init(), time.perf_counter()
            for i in range(12):
                lean = 0.1 if i >= 6 else 0.0
                wanted = command(1, (lean, 0.0), gamma=0.1, reach=REACH, hand_height=HAND_HEIGHT)
                world, plain = it.step(world, wanted)
            took[name].append(time.perf_counter() - began)
        bare.close()
    for name in Observation._fields:
        np.testing.assert_array_equal(getattr(seen, name)[-1], getattr(plain, name)[0], err_msg=name)
    # Of the pairs, as any of them may share the machine with others.
    assert min(s / b for s, b in zip(took["sensed"], took["bare"], strict=True)) < 1.5


def test_perfect_senses_end_at_walls_and_at_their_range() -> None:
    boxes = [(BOX, (2.0, 0.0, 0.0)), (BOX, (-2.0, 0.0, 0.0)), (BOX, (0.0, 6.0, 0.0))]
    scene = build_scene(boxes, walls=[(1.0, 0.0, 0.05, 2.0)])
    with SensedEngine([scene], PERFECT) as engine:
        world, seen = engine.step(engine.init(), stand())
        assert seen.detected[0].tolist() == [False, True, False]
        assert np.isnan(seen.object_pose[0, [0, 2]]).all() and np.isinf(seen.object_age[0, [0, 2]]).all()
        assert np.isfinite(seen.object_twist).all() and np.isfinite(seen.wrench).all()
        far = moved(engine, world, 1, (-4.0, 0.0))
        for i in range(1, 4):
            far, seen = engine.step(far, stand())
            assert not seen.detected[0, 1] and seen.object_age[0, 1] == pytest.approx(0.1 * i)
            np.testing.assert_allclose(seen.object_pose[0, 1, 0], -2.0, atol=1e-3)


def test_never_seen_objects_have_no_pose() -> None:
    scene = build_scene([(BOX, (-2.0, 0.0, 0.0)), (BOX, (2.0, 0.0, 0.0))], adjust=REAL.adjust(0))
    with SensedEngine([scene], REAL) as engine:
        world = engine.init()
        world, seen = engine.step(world, stand())
        for it in (engine.observe(world), seen):
            assert np.isnan(it.object_pose[0, 0]).all() and np.isinf(it.object_age[0, 0]) and not it.detected[0, 0]
            assert np.isfinite(it.object_pose[0, 1]).all() and it.detected[0, 1]
            assert np.isfinite(it.wrench).all() and np.isfinite(it.object_twist).all()
    with SensedEngine([scene], REAL, poses_known=True) as engine:
        seen = engine.observe(engine.init())
        np.testing.assert_allclose(seen.object_pose[0, 0, :2], (-2.0, 0.0), atol=0.03)


@pytest.mark.slow
def test_a_step_appears_after_the_stated_delay() -> None:
    """Frames come every 33 ms and are 20 to 40 ms old; a jump is believed from the third on."""
    believing = altered(EXACT, tracker={"gate": 1e9})
    scene = build_scene([(BOX, (2.0, 0.0, 0.0))])
    for seed in range(2):
        with SensedEngine([scene], believing, seed) as engine:
            late = int(engine._drawn.frame_delay[0])
            assert 2 <= late <= 4
            world, _ = engine.step(engine.init(), stand())
            world, first = moved(engine, world, 0, (0.1, 0.0)), None
            for i in range(1, 12):
                world, seen = engine.step(world, stand(), 0.01)
                if first is None and seen.object_pose[0, 0, 0] > 2.05:
                    first = i
            assert first is not None and late <= first <= late + 4
    with SensedEngine([scene], EXACT, 0) as engine:
        world, _ = engine.step(engine.init(), stand())
        world, first = moved(engine, world, 0, (0.3, 0.0)), None
        for i in range(1, 30):
            world, seen = engine.step(world, stand(), 0.01)
            if first is None and seen.object_pose[0, 0, 0] > 2.2:
                first = i
        assert first is not None and 8 <= first <= 15


@pytest.mark.parametrize("distance", [pytest.param(0.75, marks=pytest.mark.slow), 3.0])
def test_noise_is_that_of_the_camera_and_less_in_what_is_published(distance: float) -> None:
    still = altered(
        NOMINAL,
        odometry={"localised": False, "walk": 0.0, "yaw_walk": 0.0},
        camera={"drop_out": 0.0, "burst": 0.0},
    )
    raw = altered(still, tracker={"acceleration": 1e4, "yaw_acceleration": 1e4, "gate": 1e9})
    errors: dict[str, list[np.ndarray]] = {"raw": [], "published": []}
    scene = build_scene([(BOX, (distance, 0.0, 0.0))])
    for name, senses in (("raw", raw), ("published", still)):
        with SensedEngine([scene] * 20, senses, list(range(20))) as engine:
            world = engine.init()
            for i in range(10):
                world, seen = engine.step(world, stand(20))
                true = engine.true_observation(world)
                # A filter that trusts nothing but the last frame stands where that frame says.
                found = world.sensor_state.tracks.pose[:, 0] if name == "raw" else seen.object_pose[:, 0]
                if i >= 3:
                    errors[name].append(found - true.object_pose[:, 0])
    expected = np.array([0.005, 0.005, np.deg2rad(0.5)]) * distance / 1.5
    for name, low, high in (("raw", 0.8, 1.25), ("published", 0.4, 1.2)):
        share = np.concatenate(errors[name]).std(axis=0) / expected
        assert (share > low).all() and (share < high).all(), (name, share)


@pytest.mark.slow
def test_drop_outs_and_bursts() -> None:
    scene = build_scene([(BOX, (1.5, 0.0, 0.0))])
    blind = altered(EXACT, camera={"drop_out": 1.0})
    with SensedEngine([scene], blind) as engine:
        world = engine.init()
        for i in range(1, 4):
            world, seen = engine.step(world, stand())
            assert seen.object_age[0, 0] == pytest.approx(0.1 * i)
            assert bool(seen.detected[0, 0]) is False
    often = altered(EXACT, camera={"drop_out": 0.0, "burst": 0.1})
    with SensedEngine([scene] * 10, often, list(range(10))) as engine:
        world, ages = engine.init(), []
        for _ in range(25):
            world, seen = engine.step(world, stand(10))
            ages.append(seen.object_age[:, 0])
            assert (seen.object_age[:, 0][seen.detected[:, 0]] < 0.145).all()
            # The frame before the first sample is as old as the sample.
            least = 0.115 if len(ages) > 1 else 0.095
            assert (seen.object_age[:, 0][~seen.detected[:, 0]] > least).all()
    assert np.max(ages) > 0.4
    with SensedEngine([scene] * 10, EXACT, list(range(10))) as engine:
        world = engine.init()
        for _ in range(5):
            world, seen = engine.step(world, stand(10))
            assert seen.detected.all() and seen.object_age.max() <= 0.08 + 1e-9


def test_an_object_behind_a_wall_or_another_object_is_carried_on() -> None:
    tall = draw_condition("box", 1, {"size": [0.6, 1.0, 1.0]})
    scene = build_scene([(BOX, (3.0, 0.0, 0.0)), (tall, (1.5, 3.0, 0.0))])
    with SensedEngine([scene], EXACT) as engine:
        world, seen = engine.step(engine.init(), stand())
        assert seen.detected[0].tolist() == [True, False]
        world = moved(engine, world, 1, (0.0, -3.0))
        for _ in range(5):
            world, seen = engine.step(world, stand())
        assert seen.detected[0].tolist() == [False, True]
        assert seen.object_age[0, 0] > 0.3
        np.testing.assert_allclose(seen.object_pose[0, 0], (3.0, 0.0, 0.0), atol=0.02)


def test_the_pushed_object_stays_in_sight() -> None:
    seen, true = push(REAL, samples=30)
    assert true.object_pose[-1, 0, 0] > AHEAD[0] + 0.2
    assert seen.detected[:, 0].mean() > 0.8
    error = np.linalg.norm((seen.object_pose - true.object_pose)[:, 0, :2], axis=-1)
    assert error.mean() < 0.03


def test_the_two_are_consistent_however_far_the_robot_has_drifted() -> None:
    drifting = altered(NOMINAL, odometry={"scale": 0.1, "yaw_bias": 0.02, "localised": False})
    seen, true = push(drifting, 1, 35)
    lost = np.linalg.norm((seen.robot_pose - true.robot_pose)[-1, :2])
    assert lost > 0.03
    found, real = (se2.relative(o.robot_pose, o.object_pose[:, 0]) for o in (seen, true))
    assert np.linalg.norm((found - real)[20:, :2], axis=-1).mean() < 0.012


def test_headings_are_held_as_the_robot_believes_them() -> None:
    turning = altered(EXACT, odometry={"yaw_bias": 0.02, "localised": False})
    with SensedEngine([build_scene()], turning, 2) as engine:
        world = engine.init()
        for _ in range(60):
            world, seen = engine.step(world, stand())
        true = engine.true_observation(world)
    assert abs(true.robot_pose[0, 2]) > 0.02
    assert abs(seen.robot_pose[0, 2]) < 0.3 * abs(true.robot_pose[0, 2])


def test_force_from_joint_torque_is_near_the_contact_force() -> None:
    seen, true = push(NOMINAL, samples=25)
    force = true.wrench[15:, 0, :2]
    error = np.hypot(*(seen.wrench[15:, 0, :2] - force).T)
    assert np.hypot(*force.T).mean() > 10
    assert 1e-3 < error.mean() < 0.15 * np.hypot(*force.T).mean()
    assert not np.abs(true.wrench[:5]).any()


@pytest.mark.parametrize("gains", [(1.12,) * 6, (1.0, 0.88, 1.1, 1.0, 0.9, 1.1)])
def test_motor_constants_are_calibrated_by_what_extended_arms_weigh(gains: tuple[float, ...]) -> None:
    """Nothing is felt before there is contact, and then what there is, however wrong the motors' constants are."""
    box = draw_condition("box", 1, {"mass": 60.0, "payload": 0.0, "friction": 0.6})
    body = draw_body(Perturbation.none(), 0)._replace(arm_gain=gains)
    scene = build_scene([(box, (AHEAD[0] + 0.35, 0.0, 0.0))], adjust=adjustment(body))
    felt, true = [], []
    with SensedEngine([scene], NOMINAL) as engine:
        world = engine.init()
        for i in range(90):
            wanted = command(1, (0.02 if i < 50 else 0.07, 0.0), gamma=0.0, reach=REACH, hand_height=HAND_HEIGHT)
            world, seen = engine.step(world, wanted)
            felt.append(seen.wrench[0, 0, 0])
            true.append(engine.true_observation(world).wrench[0, 0, 0])
    felt, true = np.array(felt), np.array(true)
    touched = int(np.argmax(true != 0))
    assert 15 < touched < 60 and true[-20:].mean() > 15
    np.testing.assert_allclose(felt[touched - 6 : touched].mean(), 0.0, atol=0.7)
    np.testing.assert_allclose(felt[-20:].mean(), true[-20:].mean(), rtol=0.08)


def test_commands_take_effect_after_delay_and_computing() -> None:
    late = dataclasses.replace(PERFECT, body=dataclasses.replace(Perturbation.none(), delay=(0.04, 0.04)))
    quick, _ = push(PERFECT, samples=8)
    for senses, given in (
        (late, {}),
        (dataclasses.replace(PERFECT, computing=0.04), {}),
        (PERFECT, {"computing": 0.04}),
    ):
        slow, _ = push(senses, samples=8, **given)
        assert slow.lean[6, 0] < quick.lean[6, 0] - 1e-4
    # Longer than a sample: the last command is held meanwhile, and no command is lost.
    slow, _ = push(PERFECT, samples=10, computing=0.2)
    np.testing.assert_allclose(slow.lean[8], quick.lean[6], atol=2e-3)


def test_a_command_that_is_overtaken_is_never_followed() -> None:
    with SensedEngine([build_scene()], PERFECT) as engine:
        world, _ = engine.step(engine.init(), command(1, (0.1, 0.0)), computing=0.25)
        for _ in range(5):
            world, seen = engine.step(world, stand(), computing=0.0)
        assert np.abs(seen.lean).max() < 0.02 and world.pending == ()


def test_same_seed_same_run_and_a_state_can_be_gone_on_from() -> None:
    first, _ = push(REAL, 3, 6)
    again, _ = push(REAL, 3, 6)
    other, _ = push(REAL, 4, 6)
    for name in Observation._fields:
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name), err_msg=name)
    assert np.abs(first.object_pose - other.object_pose).max() > 1e-4
    with SensedEngine([build_scene([(BOX, AHEAD)], adjust=REAL.adjust(0))]) as engine:
        world, _ = engine.step(engine.init(), stand())
        one, two = engine.step(world, stand()), engine.step(world, stand())
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        np.testing.assert_array_equal(a, b)


def test_worlds_have_robots_and_noise_of_their_own() -> None:
    scenes = [build_scene([(BOX, AHEAD)], adjust=REAL.adjust(seed)) for seed in (1, 1, 2)]
    with SensedEngine(scenes, REAL, seed=[1, 1, 2]) as engine:
        _, seen = engine.step(engine.init(), stand(3))
    assert seen.object_pose.shape == (3, 1, 3) and seen.robot_age.shape == (3,)
    assert np.abs(np.diff(seen.object_pose[:, 0, 0])).min() > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(4, 9), (7, 2, 4)])
def test_each_world_is_what_it_is_alone_with_its_seed(seeds: tuple[int, ...]) -> None:
    scenes = [build_scene([(BOX, AHEAD)], adjust=REAL.adjust(seed)) for seed in seeds]
    wanted = [command(1, (0.02 * i, 0.0), gamma=0.1, reach=REACH, hand_height=HAND_HEIGHT) for i in range(len(seeds))]
    together = command(len(seeds), np.concatenate([c.u[:, :2] for c in wanted]), gamma=0.1)
    together = together._replace(reach=np.full(len(seeds), REACH), hand_height=np.full(len(seeds), HAND_HEIGHT))
    together = together._replace(u=np.concatenate([c.u for c in wanted]), yaw=np.concatenate([c.yaw for c in wanted]))
    with SensedEngine(scenes, REAL, seed=seeds) as engine:
        world, batch = engine.init(), []
        for _ in range(8):
            world, seen = engine.step(world, together)
            batch.append(seen)
    for i, (scene, seed) in enumerate(zip(scenes, seeds, strict=True)):
        with SensedEngine([scene], REAL, seed=np.int64(seed)) as engine:
            world = engine.init()
            for seen in batch:
                world, alone = engine.step(world, wanted[i])
                for name in Observation._fields:
                    # The control is compiled for the batch's size: its last bits may differ.
                    np.testing.assert_allclose(getattr(seen, name)[i], getattr(alone, name)[0], atol=1e-3, err_msg=name)
                    if name in ("robot_pose", "object_pose", "lean"):
                        np.testing.assert_allclose(getattr(seen, name)[i], getattr(alone, name)[0], atol=2e-6)


@pytest.mark.parametrize("senses", [PERFECT, REAL])
def test_a_world_that_diverges_is_said_to_and_touches_no_other(senses: Senses) -> None:
    scenes = [build_scene([(BOX, AHEAD)], walls=[(3.0, 0.0, 0.1, 2.0)], adjust=senses.adjust(s)) for s in (1, 2)]
    shove = np.array([[1e8, 0, 0, 0, 0, 0], [0.0] * 6])
    with SensedEngine(scenes, senses, (1, 2)) as engine:
        start, _ = engine.step(engine.init(), stand(2))
        world, seen = engine.step(start, stand(2), push=shove)
        still, expected = engine.step(start, stand(2))
        assert engine.diverged(world).tolist() == engine.fallen(world).tolist() == [True, False]
        assert not engine.diverged(still).any()
        np.testing.assert_allclose(seen.time, 0.2)
        for _ in range(2):
            for name in Observation._fields:
                np.testing.assert_array_equal(getattr(seen, name)[1], getattr(expected, name)[1], err_msg=name)
            (world, seen), (still, expected) = engine.step(world, stand(2)), engine.step(still, stand(2))
        assert engine.diverged(world).tolist() == [True, False]


def test_a_run_that_raises_closes_its_engine() -> None:
    engine = SensedEngine([build_scene([(BOX, AHEAD)])] * 2, PERFECT, threads=2)
    with pytest.raises(RuntimeError, match="on the way"), engine:
        raise RuntimeError("on the way")
    with pytest.raises(RuntimeError):
        engine.step(engine.init(), stand(2))


def test_names_of_senses() -> None:
    assert senses_named("real") is REAL and senses_named("perfect") is PERFECT
    with pytest.raises(ShmooError, match="choose real or perfect"):
        senses_named("good")
    scene = build_scene([(BOX, AHEAD)])
    with SensedEngine([scene], "perfect") as engine:
        assert engine.senses is PERFECT
    with pytest.raises(ShmooError, match="choose real or perfect"):
        SensedEngine([scene], "good")
    with pytest.raises(ShmooError, match="computing"):
        dataclasses.replace(REAL, computing=-1.0)


def test_real_senses_are_quick() -> None:
    scene = build_scene([(BOX, AHEAD)], walls=[(3.0, 0.0, 0.1, 2.0)] * 100)
    with SensedEngine([scene], PERFECT) as plain, SensedEngine([scene], REAL) as sensed:
        engines, ratios = (sensed, plain), []
        worlds = [engine.step(engine.init(), stand())[0] for engine in engines]
        for _ in range(5):  # as any of the pairs may share the machine with others
            took = []
            for i, engine in enumerate(engines):
                began = time.process_time()
                for _ in range(10):
                    worlds[i], _ = engine.step(worlds[i], stand())
                took.append(time.process_time() - began)
            ratios.append(took[0] / took[1])
    assert min(ratios) < 5.0


def test_the_watchdog_brings_the_robot_to_rest_where_commands_stop_and_keeps_it_there() -> None:
    for senses in (PERFECT, REAL):
        with SensedEngine([build_scene(adjust=senses.adjust(0))], senses) as engine:
            world = engine.init()
            for _ in range(8):
                world, _ = engine.step(world, command(1, (0.06, 0.0)))
            fast = np.abs(engine.true_observation(world).robot_twist[0, :2]).max()
            for _ in range(3):
                world, _ = engine.step(world, None)
            # A lost command or two is not yet a stop: the last one is held.
            np.testing.assert_allclose(world.held.u[0, :2], (0.06, 0.0))
            places = []
            for _ in range(80):
                world, _ = engine.step(world, None)
                places.append(engine.true_observation(world).robot_pose[0, :2])
            assert fast > 0.2 and np.abs(engine.true_observation(world).robot_twist[0, :2]).max() < 0.05
            assert np.ptp(places[30:], axis=0).max() < 0.05
            world, _ = engine.step(world, command(1, (0.02, 0.0)))
            world, _ = engine.step(world, command(1, (0.02, 0.0)))
            np.testing.assert_allclose(world.held.u[0, :2], (0.02, 0.0))
