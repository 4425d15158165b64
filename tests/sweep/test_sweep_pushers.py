"""One push, phase by phase; and that commands and frames arrive when they should."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.behavior.skills import one_push
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.control.quasi_static import control
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.geometry.hands import REACH
from shmoo_mjx.sweep import pushers
from shmoo_mjx.sweep.config import Controller, SweepConfig
from shmoo_mjx.sweep.rows import Tally, rows_of
from shmoo_mjx.sweep.simulate import commands_ago
from shmoo_mjx.sweep.worlds import draw

FACE = faces_of((0.3, 0.25))[0]
TASK = one_push.WorldGoal(jnp.asarray(FACE), jnp.array([0.3, 0.25]), jnp.array([1.0, 0.0, 0.0]))
KEY = jax.random.key(0)


def object_obs(x: float = 0.0, force: float = 0.0, gap: float = 0.0) -> ObjectObservation:
    pose = np.array([x, 0.0, 0.0])
    zero = np.zeros(2)
    robot = stand_off(pose, FACE, gap)
    values = (robot, np.zeros(3), zero, zero, pose, np.zeros(3), np.array([force, 0.0, 0.0]))
    return ObjectObservation(*(jnp.asarray(v, dtype=jnp.float32) for v in values))


def counting() -> one_push.PushPolicy:
    """A controller that counts its steps from the force it began with, pushes with that, and expects no coasting."""
    return one_push.PushPolicy(
        init=lambda now, task, key: now.wrench[0],
        step=lambda state, now, last_u, task: (jnp.stack([state, state, state]), state + 1.0),
        coast=lambda state, now: now.object_pose,
    )


def test_a_push_from_the_first_approach_to_letting_go() -> None:
    rule = counting()
    memory = one_push.init(rule, object_obs(gap=0.05), TASK, KEY)

    def step(ready: bool = True, **seen: float) -> Any:
        nonlocal memory
        command, memory = one_push.step(rule, memory, object_obs(**seen), TASK, key=KEY, ready=jnp.asarray(ready))
        return command

    assert step(ready=False, gap=0.05).u[0] == 0.0  # the arms unfold
    assert step(gap=0.05).u[0] > 0.0 and memory.phase == one_push.APPROACH
    assert step(gap=0.0, force=1.5).u[0] > 0.0 and memory.phase == one_push.APPROACH
    assert step(force=6.0).u[0] == 0.0 and memory.phase == one_push.PUSH
    # A fresh controller's first command comes a sample later, when what it has begun with says something.
    assert step(x=0.05, force=9.0).u[0] == 6.0
    assert step(x=0.1, force=9.0).u[0] == 7.0
    assert step(x=0.2, force=0.0).u[0] == 8.0 and memory.phase == one_push.PUSH  # contact may break
    let_go = step(x=0.99, force=6.0)
    assert let_go.u[0] < 0.0 and let_go.reach < REACH and memory.phase == one_push.LET_GO
    assert step(x=0.99, gap=0.02).u[0] < 0.0
    assert step(x=0.99, gap=0.2).u[0] == 0.0 and memory.phase == one_push.LET_GO


def test_what_coasts_is_let_go_earlier() -> None:
    far = counting()._replace(coast=lambda state, now: now.object_pose + jnp.array([0.2, 0.0, 0.0]))
    for rule, phase in ((far, one_push.LET_GO), (counting(), one_push.PUSH)):
        memory = one_push.init(rule, object_obs(), TASK, KEY)._replace(phase=jnp.int32(one_push.PUSH))
        for _ in range(3):
            _, memory = one_push.step(
                rule, memory, object_obs(x=0.8, force=9.0), TASK, key=KEY, ready=jnp.asarray(True)
            )
        assert memory.phase == phase


@pytest.mark.parametrize("delay", range(31))
def test_a_command_arrives_after_its_delay(delay: int) -> None:
    sent = [t // 10 for t in range(60)]  # the command of each 10 ms tick
    for tick in range(40, 60):
        newest = sent[tick]
        assert newest - int(commands_ago(jnp.int32(delay), jnp.int32(tick % 10))) == (tick - delay) // 10


def test_the_quasi_static_law_is_the_same_on_both_kinds_of_arrays() -> None:
    speed, rng = pose_push_config().speed, np.random.default_rng(0)
    for _ in range(20):
        values = [rng.normal(size=n) * 0.3 for n in (3, 3, 2, 2, 3, 3)] + [rng.normal(size=3) * 20]
        goal = rng.normal(size=3)
        plain, more = control(speed, ObjectObservation(*values), np.float64(0.01), face=FACE, goal=goal)
        traced, later = control(
            speed, ObjectObservation(*map(jnp.asarray, values)), jnp.float32(0.01), face=FACE, goal=jnp.asarray(goal)
        )
        assert isinstance(plain, np.ndarray) and isinstance(traced, jax.Array)
        np.testing.assert_allclose(traced, plain, atol=2e-5)
        np.testing.assert_allclose(later, more, atol=2e-5)


def test_a_sweeps_settings_reach_the_controller() -> None:
    config = pushers.push_config(Controller(samples=64, horizon=7, temperature=0.3, adapts=False, speed_limit=0.3))
    assert (config.control.num_rollouts, config.control.horizon, config.control.temperature) == (64, 7, 0.3)
    assert not config.adapts and config.speed.limit == 0.3
    assert pushers.push_config(Controller()) == pose_push_config()


def test_a_row_says_how_a_world_ended() -> None:
    config = SweepConfig.model_validate({"vary": {"goal.distance": 1.0, "goal.bearing": 0.1}})
    drawn = draw(config, "box", 4)
    there, ahead, turn = drawn.goal, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5])
    cases = [
        (one_push.DONE, there, "success"),
        (one_push.PUSH, there + 0.24 * ahead, "success"),
        (one_push.PUSH, there + 0.26 * ahead, "astray"),
        (one_push.DONE, there + turn, "astray"),
        (one_push.PUSH, 0.05 * ahead, "stuck"),
        (one_push.APPROACH, there, "unfelt"),
        (one_push.FELL, there, "fell"),
        (one_push.UNSTABLE, there, "unstable"),
    ]
    count = len(cases)
    poses = np.array([pose for _, pose, _ in cases])
    tally = Tally(np.full(count, 9.0), np.full(count, 5.0), np.full(count, 0.1), np.full(count, 30.0), poses)
    rows = rows_of(config, [drawn] * count, (np.array([phase for phase, _, _ in cases]), tally))
    assert [row["outcome"] for row in rows] == [outcome for _, _, outcome in cases]
    assert [row["success"] for row in rows] == [outcome == "success" for _, _, outcome in cases]
    assert [row["fell"] for row in rows] == [outcome == "fell" for _, _, outcome in cases]
    assert rows[2]["offset_m"] == pytest.approx(0.26) and rows[3]["yaw_error_deg"] == pytest.approx(np.rad2deg(0.5))
    mass, friction = rows[0]["object.mass"] + rows[0]["object.payload"], rows[0]["object.friction"]
    assert rows[0]["object.resistance"] == pytest.approx(9.81 * mass * friction)
