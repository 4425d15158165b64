"""The labels' differentiator against the simulator's own acceleration while the robot pushes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from shmoo_mjx.data.differentiate import sample_acceleration
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant import lowlevel
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.robot import readout, shmoobot
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.plant.trials import command

STEPS = 50
"""Physics steps in a sample."""


def _push(scene: Scene, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Twists ``[L + 1, 3]`` at the samples' ends and the simulator's accelerations ``[L, STEPS, 3]``, in {W}."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos0
    state, gains = lowlevel.init(np, (1,), TUCKED_REACH, TUCKED_HEIGHT), lowlevel.Gains()
    planar = scene.object_qvel[0] + np.array([0, 1, 5])
    twists, accelerations = [], np.empty((samples, STEPS, 3))
    for k in range(-8, samples):
        lean = (0.06 + 0.03 * np.sin(0.8 * k), 0.0) if k >= 0 else (0.0, 0.0)
        wanted = command(1, lean, gamma=0.3 * np.sin(0.5 * k), reach=REACH, hand_height=HAND_HEIGHT)
        twists.append(data.qvel[planar].copy())
        for i in range(STEPS):
            state, torque = lowlevel.control(
                shmoobot(), gains, state, readout(data.qpos[None], data.qvel[None]), command=wanted, dt=0.002
            )
            data.ctrl[:] = torque[0]
            data.qacc_warmstart[:] = 0.0  # as the engine does
            mujoco.mj_step(model, data)
            accelerations[max(k, 0), i] = data.qacc[planar]
    return np.array([*twists[8:], data.qvel[planar]]), accelerations


@pytest.mark.parametrize("family", ["box", "cart", "wheelchair"])
def test_difference_quotient_against_the_simulators_acceleration(family: str) -> None:
    free = {"friction": 0.3} if family == "box" else {"locked": (False,) * 4}
    condition = draw_condition(family, 4, {"payload": 0.0, "mass": 9.0} | free)
    scene = build_scene([(condition, (REACH + 0.08 + condition.half_extents[0], 0.08, 0.0))])
    twist, own = _push(scene, 30)
    label = sample_acceleration(twist)
    scale = np.sqrt(np.mean(own.mean(axis=1) ** 2, axis=0))
    assert scale[0] > 0.05
    # Over a sample's time the two are the same but for how the integrator treats damping.
    of_mean = np.sqrt(np.mean((label - own.mean(axis=1)) ** 2, axis=0))
    # The acceleration at an instant is another thing: it changes within a sample, most where contact begins.
    of_middle = np.sqrt(np.mean((label - own[:, STEPS // 2]) ** 2, axis=0))
    print(family, "rms", scale.round(4), "error of mean", of_mean.round(5), "of middle", of_middle.round(4))
    assert np.all(of_mean < 0.02 * scale + 1e-3)
    assert np.all(of_middle > of_mean)
