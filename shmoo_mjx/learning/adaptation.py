"""Online adaptation of the coefficients a by Eq. 8.

This is the discrete form from the supplement of Neural-Fly: propagate, then update with a Kalman gain. The covariance
update uses Joseph's form, which stays positive definite; plain Euler steps of P do not. Units: psi a is an
acceleration, so a has the unit of an acceleration divided by psi, and covariances have the square of that unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Scalar, single_precision
from shmoo_mjx.types import DT


@dataclass(frozen=True)
class AdaptConfig:
    """Gains of Eq. 8."""

    decay: float = 0.01
    """lambda [1/s], the rate of forgetting. Larger forgets faster."""
    to_prior: bool = True
    """Forget towards the prior mean. If False, forget towards zero, as Eq. 8 is printed."""
    process: float = 0.02
    """Q, as the fraction of the prior covariance that is added per second [1/s]. Larger follows changes of the object
    faster and is noisier. At 2 * decay the prior is the stationary state."""
    noise_scale: float = 1.0
    """R dt is noise_scale times the residual covariance from training [1]. Larger makes each sample count less; use
    values above 1 for correlated residuals."""
    outlier: float = 16.0
    """Squared Mahalanobis distance of the innovation [1]. Above it, the noise of a sample is raised in proportion to
    the distance. Larger gives fewer samples a reduced weight."""
    tracking: bool = False
    """Use the tracking term +P psi^T s dt."""


class AdaptState(NamedTuple):
    """The estimate of n = 3 K coefficients and its prior."""

    mean: Float[Array, "... n"]
    """Estimate of a, flattened (axis-major)."""
    covariance: Float[Array, "... n n"]
    """Covariance P of the estimate."""
    prior_mean: Float[Array, "... n"]
    """Mean of the prior, to which forgetting returns the estimate."""
    prior_covariance: Float[Array, "... n n"]
    """Covariance of the prior, which scales the process noise."""
    noise: Float[Array, "... 3 3"]
    """Residual covariance of one sample [(m/s^2)^2, (rad/s^2)^2]."""


@single_precision
def init(
    prior_mean: Float[Array, "3 K"] | Float[Array, "n"],
    prior_covariance: Float[Array, "n n"],
    noise: Float[Array, "3 3"],
) -> AdaptState:
    """The estimate before the first contact, which equals the prior.

    Args:
        prior_mean: mean of a.
        prior_covariance: initial P.
        noise: residual covariance of one sample.
    """
    mean = jnp.asarray(prior_mean, dtype=jnp.float32).reshape(-1)
    covariance = jnp.asarray(prior_covariance, dtype=jnp.float32)
    noise = jnp.asarray(noise, dtype=jnp.float32)
    return AdaptState(mean, covariance, mean, covariance, noise)


@single_precision
def step(
    config: AdaptConfig,
    state: AdaptState,
    phi: Float[Array, "3 n"],
    label: Float[Array, "3"],
    *,
    valid: Scalar = True,
    tracking_error: Float[Array, "3"] | None = None,
    dt: float = DT,
) -> AdaptState:
    """Update the estimate with one sample (Eq. 8). An invalid or non-finite sample leaves the state unchanged.

    Args:
        config: gains; static.
        state: estimate of one object; vmap for more.
        phi: design matrix (`object_model.design_matrix`), the psi of Eq. 8.
        label: measured acceleration of the object in {O}, the y of Eq. 8.
        valid: False without contact, or with stale or missing poses.
        tracking_error: s of Eq. 8, used if config.tracking.
        dt: time since the last sample [s].
    """
    finite = jnp.all(jnp.isfinite(phi)) & jnp.all(jnp.isfinite(label))
    if tracking_error is not None:
        finite &= jnp.all(jnp.isfinite(tracking_error))
    use = finite & jnp.asarray(valid)
    # Replace the values before any arithmetic, because NaN times zero is NaN.
    phi, label = jnp.where(use, phi, 0.0), jnp.where(use, label, 0.0)
    mean, covariance = _propagate(config, state, dt)
    innovation = label - phi @ mean
    noise = config.noise_scale * state.noise
    spread = phi @ covariance @ phi.T
    distance = innovation @ jnp.linalg.solve(spread + noise, innovation)
    # Drop labels so large that their square overflows.
    use &= jnp.isfinite(distance)
    noise = noise * jnp.maximum(1.0, distance / config.outlier)
    gain = jnp.linalg.solve(spread + noise, phi @ covariance).T
    new_mean = mean + gain @ innovation
    if config.tracking and tracking_error is not None:
        # The sign is plus and the factor is dt, as in Eq. 8. Other sources print the discrete form with a minus, which
        # diverges.
        new_mean = new_mean + covariance @ phi.T @ jnp.where(use, tracking_error, 0.0) * dt
    rest = jnp.eye(mean.shape[0]) - gain @ phi
    new_covariance = rest @ covariance @ rest.T + gain @ noise @ gain.T
    # With very large features, float32 rounding can make Joseph's form indefinite. A millionth of each variance
    # outweighs this error and is far below the process noise.
    new_covariance = 0.5 * (new_covariance + new_covariance.T) + 1e-6 * jnp.diag(jnp.diag(new_covariance))
    new = state._replace(mean=new_mean, covariance=new_covariance)
    # Finite inputs can overflow float32 in the update. Drop these samples too.
    use &= jnp.all(jnp.isfinite(new_mean)) & jnp.all(jnp.isfinite(new_covariance))
    return jax.tree.map(lambda a, b: jnp.where(use, a, b), new, state)


def _propagate(config: AdaptConfig, state: AdaptState, dt: float) -> tuple[Array, Array]:
    """Predicted mean a- and covariance P- before the update with the sample."""
    keep = 1.0 - config.decay * dt
    centre = state.prior_mean if config.to_prior else jnp.zeros_like(state.prior_mean)
    mean = centre + keep * (state.mean - centre)
    return mean, keep**2 * state.covariance + config.process * dt * state.prior_covariance
