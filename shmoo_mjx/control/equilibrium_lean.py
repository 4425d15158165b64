"""Online estimate of the equilibrium-lean offset.

If the true centre of mass is some millimetres away from that of the model, a robot at zero lean drifts. In each plane
the flat output S = x + (b/a) phi obeys a S'' = c (phi + arms - offset - h F / (m g l)) (``Robot.flatness``). The offset
is therefore the measured lean, plus the lean due to the arms, minus the lean that S'' explains.
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
"""Averaging time of the estimate [s]. Larger is less noisy and follows a shift of the centre of mass more slowly."""
_FREE = 1.0
"""Hand force above which a sample is ignored [N]. It is half the force that counts as contact."""
LIMIT = 0.04
"""Largest offset [rad], which is 2 cm at the height of the centre of mass."""


class LeanOffset(NamedTuple):
    """State of the estimate for one robot."""

    lean: Float[np.ndarray, "2"]
    """Lean at which the robot balances, in {R} [rad]."""
    samples: int
    """Number of samples used so far."""
    before: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]] | None
    """Velocity of the flat output in {W} [m/s] and lean in {R} [rad] one sample ago."""


def init() -> LeanOffset:
    """The estimate before the first sample: zero offset."""
    return LeanOffset(np.zeros(2), 0, None)


def step(state: LeanOffset, obs: Observation) -> LeanOffset:
    """The estimate after one more sample of one world."""
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
    # The gain starts as that of a plain mean and becomes that of an exponential average.
    gain = max(DT / _MEMORY, 1.0 / samples)
    offset = np.clip(state.lean + gain * error, -LIMIT, LIMIT)
    return state._replace(lean=offset, samples=samples, before=(speed, lean))


def arms_lean(hands: Float[Array, "2 3"]) -> Float[np.ndarray, "2"]:
    """Lean with which the low-level control compensates the weight of the arms [rad]. Commanded leans exclude it.

    Args:
        hands: positions of the hands, as in an Observation.
    """
    robot = shmoobot()
    in_body = np.asarray(hands, dtype=float) - [0.0, 0.0, robot.ball_radius]
    return np.asarray(robot.com_offset(robot.arm_angles(in_body))) / robot.body_com_height


def predicted(obs: Observation, seconds: float) -> Observation:
    """The observation extrapolated by ``seconds``.

    The acceleration of the robot follows from the lean minus the lean that balances the sensed force (S'' of the flat
    output). Objects keep their twist.

    Args:
        obs: observation whose lean is relative to the equilibrium lean (`corrected`).
        seconds: time to extrapolate [s].
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
    """The observation with its lean relative to the equilibrium lean."""
    return obs._replace(lean=obs.lean - state.lean)


def shifted(state: LeanOffset, command: Command) -> Command:
    """The command with its lean relative to the upright body axis, as the low-level control expects it."""
    u = np.array(command.u, dtype=float)
    u[:, :2] += state.lean
    return command._replace(u=u)
