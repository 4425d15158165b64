"""The work of one MPPI step, the same for every engine: the paper's two networks and Eq. 9, by default S = 500, T = 30.

The state has 31 numbers: robot pose 3 and twist 3, memory 19, object pose 3 and twist 3.

    z = R(robot twist, memory, object pose - robot pose, u)             28 -> 5: base acceleration, force
    v = psi(object twist, force, moment, last twist, size) a            10 -> 6, times a [3, 6]
    twists and poses integrate over 0.1 s; z, u and the object's last twist enter the memory
    cost = |goal - object pose at T| + effort sum |u| + change sum |u - u before|

This module needs only NumPy, because peers run it with another interpreter that does not have this package.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

Array = Any

R_WIDTHS = (28, 128, 128, 50, 5)
PSI_WIDTHS = (10, 128, 128, 50, 6)
DT = 0.1
EFFORT, CHANGE = 0.01, 0.02
TEMPERATURE = 0.7
SIGMA, BOUND = 0.06, 0.2


class Problem(NamedTuple):
    """Networks, coefficients, start and goal of the problem."""

    robot: list[tuple[Array, Array]]
    """Weight ``[n_in, n_out]`` and bias of each layer of R."""
    psi: list[tuple[Array, Array]]
    """Weight ``[n_in, n_out]`` and bias of each layer of psi."""
    coefficients: Array
    """Coefficients a ``[3, 6]``."""
    x0: Array
    """State ``[31]`` at the start."""
    goal: Array
    """Target pose ``[3]`` of the object."""


def draw(seed: int) -> Problem:
    """A problem with random networks of the paper's widths and a random start, in float32."""
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape).astype(np.float32)

    def net(widths: tuple[int, ...]) -> list[tuple[Array, Array]]:
        pairs = pairwise(widths)
        return [(normal(n, m) / np.float32(np.sqrt(n)), np.float32(0.1) * normal(m)) for n, m in pairs]

    goal = np.array([1.0, -0.5, 0.3], np.float32)
    return Problem(net(R_WIDTHS), net(PSI_WIDTHS), normal(3, 6) / 10, normal(31) / 10, goal)


def flop(samples: int, horizon: int) -> int:
    """Floating point operations of the two networks' matrix products in one step, which no engine can avoid."""
    pairs = [p for widths in (R_WIDTHS, PSI_WIDTHS) for p in pairwise(widths)]
    return 2 * samples * horizon * sum(n * m for n, m in pairs)


def transition(xp: Any, robot: Any, push: Any, *, x: Array, u: Array) -> Array:
    """The state ``[S, 31]`` one sample later.

    Args:
        xp: numpy, jax.numpy or torch.
        robot: R as a function of a batch of inputs.
        push: psi a as a function of a batch of inputs.
        x: ``[S, 31]`` state.
        u: ``[S, 3]`` control.
    """

    def join(*parts: Array) -> Array:
        return xp.concatenate(parts, 1)

    pose, twist, memory, object_pose, object_twist = x[:, :3], x[:, 3:6], x[:, 6:25], x[:, 25:28], x[:, 28:]
    z = robot(join(twist, memory, object_pose - pose, u))
    lever = object_pose[:, :2] - pose[:, :2]
    moment = lever[:, :1] * z[:, 4:5] - lever[:, 1:2] * z[:, 3:4]
    acceleration = push(join(object_twist, z[:, 3:5], moment, memory[:, :3], memory[:, 18:]))
    twist = twist + DT * z[:, :3]
    after = object_twist + DT * acceleration
    memory = join(object_twist, z, u, memory[:, 11:])
    return join(pose + DT * twist, twist, memory, object_pose + DT * after, after)


def cost(xp: Any, goal: Array, last: Array, controls: Array) -> Array:
    """Cost ``[S]`` of Eq. 9.

    Args:
        xp: numpy, jax.numpy or torch.
        goal: ``[3]`` target pose of the object.
        last: ``[S, 31]`` states at the end of the horizon.
        controls: ``[S, T, 3]`` controls.
    """

    def norm(v: Array) -> Array:
        return xp.sqrt((v * v).sum(-1))

    change = norm(controls[:, 1:] - controls[:, :-1]).sum(-1)
    return norm(last[:, 25:28] - goal) + EFFORT * norm(controls).sum(-1) + CHANGE * change
