"""R: the network that predicts the base's acceleration and the force of the hands on the object (Eq. 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm

from shmoo_mjx.arrays import Array, Float, Key
from shmoo_mjx.dynamics import features, fused, networks
from shmoo_mjx.dynamics.networks import Network
from shmoo_mjx.types import DT

REFLECTIONS = (features.reflection(features.ROBOT_INPUTS), features.reflection(features.ROBOT_OUTPUTS))
"""Reflection matrices of the inputs and outputs of R."""


@dataclass(frozen=True)
class RobotConfig:
    """Structure of R."""

    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers. They are half of the paper's: pushes end equally close to their goals, and plans
    take less time."""
    activation: str = "relu"
    """Name in `networks.ACTIVATIONS`."""

    @classmethod
    def paper(cls) -> RobotConfig:
        """R with the widths printed in the paper, [28, 128, 128, 50, 5]."""
        return cls(hidden=(128, 128, 50))


class LeanResponse(NamedTuple):
    """Response of the lean to its command over one sample: a second-order lag, exactly discretised."""

    matrix: Float[Array, "2 2 5"]
    """For x and y: from (lean [rad], its rate [rad/s], command [rad], force of the hands on the object over the last
    sample [N], 1) to (lean, its rate) one sample later. The force column describes how contact forces lean the body.
    The constant column describes the offset from the weight of the extended arms."""


class RobotParams(NamedTuple):
    """Learned parameters of R and of the lean response."""

    net: Network
    """Parameters of an `EquivariantMLP`."""
    output_mean: Float[Array, "5"]
    """Mean of the outputs, in the units of ROBOT_OUTPUTS."""
    output_scale: Float[Array, "5"]
    """Standard deviation of the outputs, in the units of ROBOT_OUTPUTS."""
    lean: LeanResponse
    """Response of the lean to its command."""


def init(key: Key[jax.Array, ""], config: RobotConfig | None = None) -> RobotParams:
    """Untrained parameters."""
    config = config or RobotConfig()
    n_in, n_out = features.width(features.ROBOT_INPUTS), features.width(features.ROBOT_OUTPUTS)
    return RobotParams(
        net=networks.init(_module(config), key, n_in),
        output_mean=jnp.zeros(n_out),
        output_scale=jnp.ones(n_out),
        lean=lag(8.0, 0.9),
    )


def predict(
    params: RobotParams, inputs: Float[Array, "... 28"], config: RobotConfig
) -> tuple[Float[Array, "... 3"], Float[Array, "... 2"]]:
    """R of Eq. 2: base acceleration [m/s^2, rad/s^2] and hand force [N], both in {R}."""
    out = normalised(params.net, inputs, config) * params.output_scale + params.output_mean
    return out[..., :3], out[..., 3:]


def normalised(net: Network, inputs: Float[Array, "... 28"], config: RobotConfig) -> Float[Array, "... 5"]:
    """Outputs of R before they are scaled by ``output_scale`` and shifted by ``output_mean``."""
    return networks.apply(_module(config), net, inputs)


def fuse(params: RobotParams) -> fused.FusedEquivariantMLP:
    """R in the form for roll-outs. Its `forward` gives the outputs in the units of ROBOT_OUTPUTS."""
    net = fused.fuse_equivariant(params.net, REFLECTIONS)
    return net.followed_by(lambda rows: (rows.T * params.output_scale).T).with_affine(None, params.output_mean)


def _module(config: RobotConfig) -> networks.EquivariantMLP:
    widths = (*config.hidden, features.width(features.ROBOT_OUTPUTS))
    return networks.EquivariantMLP(widths, REFLECTIONS, config.activation)


def lag(frequency: float, damping: float, dt: float = DT) -> LeanResponse:
    """The response phi'' = w^2 (u - phi) - 2 zeta w phi', the same in x and y.

    Args:
        frequency: w [rad/s]; larger responds faster.
        damping: zeta [1]; larger oscillates less.
        dt: sample time [s].
    """
    system = np.array([[0.0, 1.0, 0.0], [-(frequency**2), -2 * damping * frequency, frequency**2], [0.0, 0.0, 0.0]])
    matrix = np.zeros((2, 2, 5), np.float32)
    matrix[:, :, :3] = expm(system * dt)[:2]
    return LeanResponse(jnp.asarray(matrix))


def lean_step(
    response: LeanResponse,
    lean: Float[Array, "2 ..."],
    rate: Float[Array, "2 ..."],
    *,
    target: Float[Array, "2 ..."],
    force: Float[Array, "2 ..."],
) -> tuple[Float[Array, "2 ..."], Float[Array, "2 ..."]]:
    """Lean [rad] and its rate [rad/s] one sample later, channels first.

    Args:
        response: the lean response.
        lean: lean [rad].
        rate: rate of the lean [rad/s].
        target: command [rad].
        force: force of the hands on the object over the last sample, in {R} [N].
    """
    m = response.matrix.reshape(*response.matrix.shape, *(1,) * (lean.ndim - 1))
    inputs = (lean, rate, target, force, 1.0)
    new, new_rate = (sum(m[:, row, k] * inputs[k] for k in range(5)) for row in range(2))
    return jnp.asarray(new), jnp.asarray(new_rate)
