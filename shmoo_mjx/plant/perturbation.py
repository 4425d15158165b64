"""Perturbed robot body, unknown to the control and the models: a stand-in for the real hardware.

Mass, CoM, drive friction, motor gains and motor lag differ from the nominal robot, and commands are delayed. Sensing is
simulated in `shmoo_mjx.sensing`. Training does not use perturbed bodies.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

_TICK = 0.01
"""Delays are rounded to multiples of this time [s]."""


@dataclass(frozen=True)
class Perturbation:
    """How much drawn robot bodies differ from the training plant's body.

    Values are half widths of uniform draws, relative to nominal unless a unit is given. ``motor_lag`` is not drawn, and
    ``delay`` is a range. 0 switches a difference off. Larger values make robots differ more.
    """

    body_mass: float = 0.15
    """Mass and inertia of the torso."""
    body_com: float = 0.005
    """Shift of the torso's CoM along x and y [m]."""
    body_com_height: float = 0.04
    """Shift of the torso's CoM along z [m]."""
    drive_friction: float = 0.4
    """Coulomb and viscous friction between body and ball."""
    drive_gain: float = 0.05
    """Torque of the drive motors divided by the commanded torque; one factor for all three."""
    arm_gain: float = 0.15
    """Torque of an arm motor divided by the commanded torque; one factor per motor."""
    motor_lag: float = 0.01
    """Time constant of every motor [s]; the same for all robots. Larger values slow the motors down."""
    delay: tuple[float, float] = (0.02, 0.04)
    """Range of the command delay [s], rounded to 10 ms. With a longer delay the robot responds later and sways more."""

    @classmethod
    def none(cls) -> Perturbation:
        """No perturbation: the training plant."""
        zeros: dict[str, Any] = {f.name: 0.0 for f in dataclasses.fields(cls)}
        return cls(**zeros | {"delay": (0.0, 0.0)})


class PerturbedBody(NamedTuple):
    """One drawn robot body: factors on the nominal values unless a unit is given. See :class:`Perturbation`."""

    mass: float
    """Factor on the torso's mass and inertia."""
    com: tuple[float, float, float]
    """Shift of the torso's CoM [m]."""
    drive_friction: float
    """Factor on Coulomb and viscous drive friction."""
    drive_gain: float
    """Factor on the torque of the drive motors."""
    arm_gain: tuple[float, ...]
    """Factor on the torque of each arm motor, ``[6]``."""
    motor_lag: float
    """Time constant of every motor [s]."""
    delay: float
    """Command delay [s]."""


def draw_body(perturbation: Perturbation, seed: int) -> PerturbedBody:
    """Draw a robot body from a seed."""
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
    """The argument ``adjust`` of :func:`~shmoo_mjx.plant.scene.build_scene` that applies this body to the robot."""

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
