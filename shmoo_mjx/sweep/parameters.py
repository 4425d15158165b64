"""Parameters that a sweep can vary, with their default values, units and bounds."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

from shmoo_mjx.plant.lowlevel import Gains

MOST_DELAY = 0.3
"""Largest delay of commands and of the camera [s]."""

RESISTANCE = "object.resistance"
"""Column of the force that keeps the object in straight motion [N]. It follows from mass and friction."""


class Parameter(NamedTuple):
    """One parameter of a world."""

    default: float | None
    """Value if the sweep does not vary the parameter; None if the object's seed draws it."""
    unit: str
    """Unit of the values."""
    low: float
    """Smallest allowed value."""
    high: float
    """Largest allowed value."""
    text: str
    """Description for users."""


def _gains() -> dict[str, Parameter]:
    fields = dataclasses.fields(Gains)
    text = "gain of the low-level control (plant/lowlevel.py)"
    return {f"gains.{f.name}": Parameter(float(f.default), "SI", 0.0, math.inf, text) for f in fields}  # type: ignore[arg-type]


PARAMETERS: dict[str, Parameter] = {
    "object.mass": Parameter(None, "kg", 0.5, 500.0, "mass of the empty object"),
    "object.payload": Parameter(None, "kg", 0.0, 500.0, "mass of its load"),
    "object.payload_x": Parameter(None, "m", -1.0, 1.0, "forward offset of the load"),
    "object.payload_y": Parameter(None, "m", -1.0, 1.0, "leftward offset of the load"),
    "object.friction": Parameter(None, "1", 0.05, 2.0, "Coulomb coefficient of sole or wheels on the floor"),
    "object.rolling": Parameter(None, "1", 0.0, 1.0, "rolling resistance coefficient of every wheel"),
    "object.swivel_friction": Parameter(None, "N m", 1e-4, 10.0, "dry friction of each caster's swivel"),
    "robot.body_mass": Parameter(1.0, "of nominal", 0.2, 5.0, "mass and inertia of the torso"),
    "robot.com_x": Parameter(0.0, "m", -0.2, 0.2, "forward shift of the torso's centre of mass"),
    "robot.com_y": Parameter(0.0, "m", -0.2, 0.2, "leftward shift"),
    "robot.com_z": Parameter(0.0, "m", -0.4, 0.4, "upward shift"),
    "robot.arm_mass": Parameter(1.0, "of nominal", 0.2, 5.0, "mass and inertia of the arms"),
    "robot.drive_friction": Parameter(1.0, "of nominal", 0.0, 5.0, "Coulomb and viscous friction of the drive"),
    "robot.torque_gain": Parameter(
        1.0, "of nominal", 0.1, 3.0, "ratio of motor torque to commanded torque, all motors"
    ),
    "robot.hand_friction": Parameter(1.0, "of nominal", 0.05, 3.0, "friction of the hands on the object"),
    **_gains(),
    "noise.position": Parameter(0.0, "m", 0.0, 0.5, "standard deviation of the object's perceived position"),
    "noise.yaw": Parameter(0.0, "rad", 0.0, 1.0, "standard deviation of its perceived yaw"),
    "noise.velocity": Parameter(0.0, "m/s", 0.0, 1.0, "standard deviation of its perceived velocity"),
    "noise.yaw_rate": Parameter(0.0, "rad/s", 0.0, 2.0, "standard deviation of its perceived yaw rate"),
    "noise.lean": Parameter(
        0.0, "rad", 0.0, 0.2, "standard deviation of the robot's lean; five times larger for its rate"
    ),
    "noise.force": Parameter(0.0, "N", 0.0, 50.0, "standard deviation of the hands' force"),
    "delay.command": Parameter(
        0.0, "s", 0.0, MOST_DELAY, "delay of commands to the low-level control, in steps of 10 ms"
    ),
    "delay.camera": Parameter(
        0.0, "s", 0.0, MOST_DELAY, "age of the object's perceived pose and twist, in steps of 10 ms"
    ),
    "start.gap": Parameter(0.05, "m", 0.0, 0.5, "gap between the hands and the face"),
    "start.lateral": Parameter(0.0, "m", -0.5, 0.5, "offset of the robot along the face, to its left"),
    "start.yaw": Parameter(0.0, "rad", -0.5, 0.5, "angle between the robot's heading and the face's normal"),
    "goal.distance": Parameter(1.0, "m", 0.1, 4.0, "distance from the object's start to its goal"),
    "goal.bearing": Parameter(
        0.0, "rad", -1.0, 1.0, "bearing of the goal relative to the push; the goal's yaw is twice this, as on an arc"
    ),
}
