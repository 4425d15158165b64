"""ALPaCA (Harrison et al. 2018): Bayesian linear regression on learned features, meta-trained by its own likelihood."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.learning.baselines.gradient import Layers, Task, dense, layers, meta_train
from shmoo_mjx.learning.baselines.networks import HIDDEN
from shmoo_mjx.learning.baselines.protocol import Context, Job, Predictor, output_scale
from shmoo_mjx.learning.baselines.sight import sight

__all__ = ["alpaca"]

Array = Any


class _Params(NamedTuple):
    features: Layers
    mean: Array
    """``[d, m]`` prior mean of the last layer."""
    factor: Array
    """``[d, d]`` factor of the prior precision."""
    log_noise: Array
    """``[m]`` log of the standard deviation of a sample's residual, in units of the label scale."""


def alpaca(job: Job) -> Predictor:
    """Features of setting["features"] dimensions; the last layer's posterior is the adaptation."""
    sees, scale = sight(job), output_scale(job.train.rows)
    d, axes = job.setting["features"], scale.shape[0]
    net_key, mean_key = jax.random.split(jax.random.key(job.seed))
    start = _Params(
        layers(net_key, sees.mean.shape[0], *HIDDEN, d),
        0.1 * jax.random.normal(mean_key, (d, axes)),
        jnp.eye(d),
        jnp.full(axes, jnp.log(0.5)),
    )

    def basis(params: _Params, x: Array, body: Array) -> Array:
        return jnp.tanh(dense(params.features, sees(x, body)))

    def posterior(params: _Params, context: Context, body: Array) -> tuple[Array, Array]:
        phi = basis(params, context.inputs, body)
        weighted = phi * context.weights[:, None]
        prior = params.factor @ params.factor.T + 1e-3 * jnp.eye(d)
        precision = prior + weighted.T @ phi
        factor = jax.scipy.linalg.cho_factor(precision, lower=True)
        right = prior @ params.mean + weighted.T @ (context.labels / scale)
        return jax.scipy.linalg.cho_solve(factor, right), jax.scipy.linalg.cho_solve(factor, jnp.eye(d))

    def loss(params: _Params, task: Task) -> Array:
        """Negative log likelihood of rows given the context; Gaussian with covariance (1 + phi' P phi) Sigma."""
        body = sees.body(task.context)
        last, covariance = posterior(params, task.context, body)
        inputs, labels = (a[:, 0] for a in task.windows[:2])
        phi = basis(params, inputs, body)
        stretch = 1.0 + jnp.einsum("bi,ij,bj->b", phi, covariance, phi)
        error = (labels / scale - phi @ last) * jnp.exp(-params.log_noise)
        axes = error.shape[-1]
        return jnp.mean(0.5 * jnp.sum(error**2, axis=-1) / stretch + 0.5 * axes * jnp.log(stretch)) + jnp.sum(
            params.log_noise
        )

    def predictor(params: _Params) -> Predictor:
        def adapt(context: Context) -> tuple[Array, Array]:
            body = sees.body(context)
            return posterior(params, context, body)[0], body

        def predict(state: tuple[Array, Array], x: Array, time: Array) -> Array:
            last, body = state
            return basis(params, x, body) @ last * scale

        return Predictor(jax.jit(adapt), predict)

    return predictor(meta_train(job, start, predictor, "alpaca", sees, loss))
