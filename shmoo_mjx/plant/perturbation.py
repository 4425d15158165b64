"""Perturbed robot body: one that the control and the models do not know, which stands for the hardware.

Mass, CoM, drive friction, motor gains and motor lag differ, and commands arrive late. How such a robot perceives is
`shmoo_mjx.sensing`'s matter. Training never sees any of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

_TICK = 0.01
"""What delays are rounded to [s]."""


@dataclass(frozen=True)
class Perturbation:
    """Every difference from the training plant's body; 0 switches one off. Widths of draws are relative, and each
    number raised makes robots differ more."""

    body_mass: float = 0.15
    body_com: float = 0.005
    """Shift of the torso's CoM along x and y [m]."""
    body_com_height: float = 0.04
    """Shift of the torso's CoM along z [m]."""
    drive_friction: float = 0.4
    drive_gain: float = 0.05
    arm_gain: float = 0.15
    """Torque of the arms' motors over what is asked of them."""
    motor_lag: float = 0.01
    """Time constant of every motor [s]."""
    delay: tuple[float, float] = (0.02, 0.04)
    """Range of the delay of commands on their way to the motors [s], rounded to 10 ms. Longer: the robot answers later
    and sways more."""

    @classmethod
    def none(cls) -> Perturbation:
        """The training plant."""
        zeros: dict[str, Any] = {f.name: 0.0 for f in dataclasses.fields(cls)}
        return cls(**zeros | {"delay": (0.0, 0.0)})


class PerturbedBody(NamedTuple):
    """One drawn robot: factors and shifts on the nominal one."""

    mass: float
    com: tuple[float, float, float]
    """[m]"""
    drive_friction: float
    drive_gain: float
    arm_gain: tuple[float, ...]
    """``[6]``"""
    motor_lag: float
    """[s]"""
    delay: float
    """[s]"""


def draw_body(perturbation: Perturbation, seed: int) -> PerturbedBody:
    """The robot with this seed."""
    rng = np.random.default_rng([7, seed])
    unit = rng.uniform(-1, 1, 13)
    at = perturbation
    delay = at.delay[0] + (at.delay[1] - at.delay[0]) * (unit[6] + 1) / 2
    return PerturbedBody(
        mass=1 + at.body_mass * unit[0],
        com=(at.body_com * unit[1], at.body_com * unit[2], at.body_com_height * unit[3]),
        drive_friction=1 + at.drive_friction * unit[4],
        drive_gain=1 + at.drive_gain * unit[5],
        arm_gain=tuple((1 + at.arm_gain * unit[7:]).tolist()),
        motor_lag=at.motor_lag,
        delay=round(float(delay) / _TICK) * _TICK,
    )


def adjustment(body: PerturbedBody) -> Callable[[mujoco.MjSpec], None]:
    """Argument ``adjust`` of :func:`~shmoo_mjx.plant.scene.build_scene` that builds this robot."""

    def adjust(spec: mujoco.MjSpec) -> None:
        torso, ball = spec.body("robot/torso"), spec.joint("robot/ball")
        torso.mass *= body.mass
        torso.inertia = body.mass * np.asarray(torso.inertia)
        torso.ipos = np.asarray(torso.ipos) + body.com
        ball.frictionloss = body.drive_friction * np.asarray(ball.frictionloss)
        ball.damping = body.drive_friction * np.asarray(ball.damping)
        for i, motor in enumerate(a for a in spec.actuators if a.name.startswith("robot/")):
            motor.gear = (body.drive_gain if i < 3 else body.arm_gain[i - 3]) * np.asarray(motor.gear)
            if body.motor_lag > 0:
                motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
                motor.dynprm[0] = body.motor_lag

    return adjust
