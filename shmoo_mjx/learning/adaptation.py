"""Online adaptation of the coefficients a by Eq. 8.

The discrete form of Neural-Fly's supplement: propagate, then update by a Kalman gain with Joseph's form of the
covariance, which stays positive definite where plain Euler steps of P do not. Units: a is in units of psi's inverse
(psi a is an acceleration), so covariances are in a squared.
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
    """lambda [1/s]: forgetting, towards the prior or towards zero."""
    to_prior: bool = True
    """Forget towards the prior's mean; Eq. 8 as printed forgets towards zero."""
    process: float = 0.02
    """Q as a share of the prior covariance added per second [1/s]. With 2 * decay the prior is the stationary state."""
    noise_scale: float = 1.0
    """R dt = noise_scale times the residual covariance found in training [1]; above 1 for correlated residuals."""
    outlier: float = 16.0
    """Squared Mahalanobis distance of the innovation above which a sample's noise is raised in proportion [1]."""
    tracking: bool = False
    """Use the term +P psi^T s dt."""


class AdaptState(NamedTuple):
    """The estimate and what it relaxes to. n = 3 K coefficients."""

    mean: Float[Array, "... n"]
    """a, flattened (axis-major)."""
    covariance: Float[Array, "... n n"]
    """P."""
    prior_mean: Float[Array, "... n"]
    prior_covariance: Float[Array, "... n n"]
    noise: Float[Array, "... 3 3"]
    """Covariance of a sample's residual [(m/s^2)^2, (rad/s^2)^2]."""


@single_precision
def init(
    prior_mean: Float[Array, "3 K"] | Float[Array, "n"],
    prior_covariance: Float[Array, "n n"],
    noise: Float[Array, "3 3"],
) -> AdaptState:
    """Estimate before the object is touched: the prior.

    Args:
        prior_mean: of a.
        prior_covariance: P at the start.
        noise: covariance of a sample's residual.
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
    """One sample of Eq. 8. A sample that is not valid or not finite leaves the state as it is.

    Args:
        config: gains; static.
        state: unbatched; vmap for more.
        phi: design matrix (`object_model.design_matrix`), the psi of Eq. 8.
        label: measured acceleration of the object in {O}, y of Eq. 8.
        valid: False without contact, with stale or missing poses.
        tracking_error: s of Eq. 8, used if config.tracking.
        dt: time since the last sample [s].
    """
    finite = jnp.all(jnp.isfinite(phi)) & jnp.all(jnp.isfinite(label))
    if tracking_error is not None:
        finite &= jnp.all(jnp.isfinite(tracking_error))
    use = finite & jnp.asarray(valid)
    # Replaced before any arithmetic: NaN times zero is still NaN.
    phi, label = jnp.where(use, phi, 0.0), jnp.where(use, label, 0.0)
    mean, covariance = _propagate(config, state, dt)
    innovation = label - phi @ mean
    noise = config.noise_scale * state.noise
    spread = phi @ covariance @ phi.T
    distance = innovation @ jnp.linalg.solve(spread + noise, innovation)
    # Of a label so far off that its square overflows nothing can be learned either.
    use &= jnp.isfinite(distance)
    noise = noise * jnp.maximum(1.0, distance / config.outlier)
    gain = jnp.linalg.solve(spread + noise, phi @ covariance).T
    new_mean = mean + gain @ innovation
    if config.tracking and tracking_error is not None:
        # Plus and times dt, as in Eq. 8: the discrete form is printed elsewhere with a minus, which diverges.
        new_mean = new_mean + covariance @ phi.T @ jnp.where(use, tracking_error, 0.0) * dt
    rest = jnp.eye(mean.shape[0]) - gain @ phi
    new_covariance = rest @ covariance @ rest.T + gain @ noise @ gain.T
    # Joseph's form is positive definite but for float32's rounding, which huge features bring to light; a millionth of
    # each variance outweighs that and is far below the process noise.
    new_covariance = 0.5 * (new_covariance + new_covariance.T) + 1e-6 * jnp.diag(jnp.diag(new_covariance))
    new = state._replace(mean=new_mean, covariance=new_covariance)
    # Finite inputs can still overflow float32; such a sample is dropped as well.
    use &= jnp.all(jnp.isfinite(new_mean)) & jnp.all(jnp.isfinite(new_covariance))
    return jax.tree.map(lambda a, b: jnp.where(use, a, b), new, state)


def _propagate(config: AdaptConfig, state: AdaptState, dt: float) -> tuple[Array, Array]:
    """a- and P-, before the sample is looked at."""
    keep = 1.0 - config.decay * dt
    centre = state.prior_mean if config.to_prior else jnp.zeros_like(state.prior_mean)
    mean = centre + keep * (state.mean - centre)
    return mean, keep**2 * state.covariance + config.process * dt * state.prior_covariance
