"""Online estimate of the equilibrium-lean offset.

A centre of mass that lies some millimetres beside where the model has it makes a robot at zero lean drift off. Along
the flat output S = x + (b/a) phi one plane obeys a S'' = c (phi + arms - offset - h F / (m g l)) (``Robot.flatness``),
so the offset is what the measured lean, with what the arms weigh, has more than S'' explains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.control.governor import static_lean
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.types import DT, Command, Observation

_MEMORY = 4.0
"""Time over which the estimate averages [s]: shorter lets the noise of the twist through, longer follows a shift of
the centre of mass late."""
_FREE = 1.0
"""Hand force from which a sample is left out [N]: half of what counts as contact."""
LIMIT = 0.04
"""Largest offset [rad]: 2 cm at the height of the centre of mass."""


class LeanOffset(NamedTuple):
    """State of the estimate for one robot."""

    lean: Float[np.ndarray, "2"]
    """Lean at which the robot balances, in {R} [rad]."""
    samples: int
    """Samples that it rests on so far."""
    before: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]] | None
    """Velocity of the flat output in {W} and lean in {R}, a sample ago."""


def init() -> LeanOffset:
    """Estimate before the first sample: no offset."""
    return LeanOffset(np.zeros(2), 0, None)


def step(state: LeanOffset, obs: Observation) -> LeanOffset:
    """Estimate after one more sample of one world."""
    a, b, c = shmoobot().flatness
    yaw = obs.robot_pose[0, 2]
    lean = np.asarray(obs.lean[0], dtype=float)
    speed = obs.robot_twist[0, :2] + b / a * se2.rotate(obs.lean_rate[0], yaw)
    touching = np.hypot(obs.wrench[0, :, 0], obs.wrench[0, :, 1]).max(initial=0.0) > _FREE
    if state.before is None or touching:
        return state._replace(before=(speed, lean))
    explained = a / c * se2.rotate(speed - state.before[0], -yaw) / DT
    error = 0.5 * (lean + state.before[1]) + arms_lean(obs.hands[0]) - explained - state.lean
    samples = state.samples + 1
    # The first seconds count in full: a mean grows into a fading memory.
    gain = max(DT / _MEMORY, 1.0 / samples)
    offset = np.clip(state.lean + gain * error, -LIMIT, LIMIT)
    return state._replace(lean=offset, samples=samples, before=(speed, lean))


def arms_lean(hands: Float[Array, "2 3"]) -> Float[np.ndarray, "2"]:
    """Lean [rad] by which the low-level control compensates the arms; the lean is commanded without it.

    Args:
        hands: as in an Observation.
    """
    robot = shmoobot()
    in_body = np.asarray(hands, dtype=float) - [0.0, 0.0, robot.ball_radius]
    return np.asarray(robot.com_offset(robot.arm_angles(in_body))) / robot.body_com_height


def predicted(obs: Observation, seconds: float) -> Observation:
    """Robot and objects extrapolated by ``seconds``; ``obs`` counts the lean from where the robot balances.

    What the lean has beyond the felt force moves the robot (S'' of the flat output), and objects keep their twist.
    """
    if not seconds:
        return obs
    a, _, c = shmoobot().flatness
    yaw = obs.robot_pose[:, 2]
    felt = static_lean(np.sum(obs.wrench[..., :2], axis=1))
    push = c / a * (se2.rotate(obs.lean + arms_lean(obs.hands[0]), yaw) - felt)
    twist, pose = np.array(obs.robot_twist, dtype=float), np.array(obs.robot_pose, dtype=float)
    pose += seconds * twist
    pose[:, :2] += 0.5 * seconds**2 * push
    twist[:, :2] += seconds * push
    objects = np.asarray(obs.object_pose, dtype=float) + seconds * np.asarray(obs.object_twist)
    lean = obs.lean + seconds * obs.lean_rate
    return obs._replace(robot_pose=pose, robot_twist=twist, lean=lean, object_pose=objects)


def corrected(state: LeanOffset, obs: Observation) -> Observation:
    """The observation with its lean counted from where the robot balances."""
    return obs._replace(lean=obs.lean - state.lean)


def shifted(state: LeanOffset, command: Command) -> Command:
    """The command with its lean counted from where the body's axis is upright, as the low-level control takes it."""
    u = np.array(command.u, dtype=float)
    u[:, :2] += state.lean
    return command._replace(u=u)
