"""Methods built on DAIML: ours, the paper's exact form, the prior alone, and a residual on a common network."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics import contact_model, object_model
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.evaluation.baselines.networks import mlp
from shmoo_mjx.evaluation.baselines.protocol import Context, Job, Predictor, Recordings
from shmoo_mjx.evaluation.baselines.sight import sight
from shmoo_mjx.learning import daiml, estimate, least_squares
from shmoo_mjx.learning.daiml import NORM_CAP, DaimlConfig, ObjectFit


def paper_config() -> DaimlConfig:
    """Settings of the paper's printed form: its psi, a ridge instead of a learned prior, and Eq. 4 on accelerations."""
    return DaimlConfig(object=ObjectConfig.paper(), coupled=False, loss_on_twist=False)


def daiml_config(job: Job, config: DaimlConfig) -> DaimlConfig:
    """``config`` with the budget, seed and setting of the job. Settings named in ObjectConfig apply to psi."""
    of_psi = {f.name for f in fields(ObjectConfig)}
    shape = {key: value for key, value in job.setting.items() if key in of_psi}
    rest = {key: value for key, value in job.setting.items() if key not in of_psi}
    return replace(
        config,
        object=replace(config.object, **shape),
        epochs=job.budget.epochs,
        epoch_updates=job.budget.epoch_updates,
        patience=job.budget.patience,
        fit_samples=job.fit_samples,
        seed=job.seed,
        **rest,
    )


def ours(job: Job) -> Predictor:
    """psi as shipped, trained on the job."""
    return from_fit(*trained(job, DaimlConfig()))


def paper_form(job: Job) -> Predictor:
    """psi as printed in the paper, trained on the job: a* by Eq. 5 with a ridge."""
    return from_fit(*trained(job, paper_config()))


def prior(job: Job) -> Predictor:
    """psi as shipped, with the coefficients before contact."""
    return prior_of(*trained(job, DaimlConfig()))


def paper_prior(job: Job) -> Predictor:
    """psi as printed in the paper, with the coefficients before contact."""
    return prior_of(*trained(job, paper_config()))


def residual(job: Job) -> Predictor:
    """A common network over all conditions, and psi on its residual (Sec. V-B). Both train for the whole budget.

    Both see the contact model, whose parameters are estimated from the labels and not from the residual. In training,
    the residual is computed with the best estimate of the contact parameters of each condition, and psi sees the same
    parameters.
    """
    common_job = replace(job, setting={"learning_rate": 1e-3}, directory=_beside(job, "common"))
    common, sees = mlp(common_job, contact_model=True), sight(common_job)
    config = replace(daiml_config(job, DaimlConfig()), open_loop=False, horizon=1)
    prior, contacts, held_contacts = sees.contacts

    def predicted(context: Context) -> Float[Array, "N m"]:
        return common.predict(common.adapt(context), context.inputs, context.time)

    def left(recorded: Recordings, contacts: Float[Array, "C p"]) -> daiml.Samples:
        samples = recorded.samples
        contexts = Context(*samples[:3], recorded.time, contacts)
        return samples._replace(labels=samples.labels - np.asarray(jax.jit(jax.vmap(predicted))(contexts)))

    samples, held_out = left(job.train, contacts[:, -1]), left(job.validation, held_contacts)
    known_contacts = prior, contacts[:, -1:], held_contacts
    own = from_fit(
        daiml.fit_samples(samples, held_out, config, out_dir=_beside(job, "psi"), known_contacts=known_contacts), config
    )

    def adapt(context: Context) -> tuple[Any, Any]:
        context = context._replace(contact=sees.contact(context))
        return common.adapt(context), own.adapt(context._replace(labels=context.labels - predicted(context)))

    def predict(
        state: tuple[Any, Any], x: Float[Array, "*batch n"], time: Float[Array, "*batch"]
    ) -> Float[Array, "*batch m"]:
        return common.predict(state[0], x, time) + own.predict(state[1], x, time)

    return Predictor(jax.jit(adapt), predict)


def from_fit(fitted: ObjectFit, config: DaimlConfig) -> Predictor:
    """Predictor of a trained psi. a* comes from the learned prior if ``config.coupled``, or else from a plain ridge."""
    arrays = ("params", "prior_mean", "prior_covariance", "noise", "contact_prior")
    fitted = fitted._replace(**{name: jax.tree.map(jnp.asarray, getattr(fitted, name)) for name in arrays})
    params, mean = fitted.params, fitted.prior_mean

    def adapt(context: Context) -> tuple[Float[Array, "m K"], Float[Array, "p"]]:
        x, y, w = context.inputs, context.labels, context.weights
        contact = jnp.zeros(len(contact_model.PARAMETERS)) if context.contact is None else context.contact
        if config.object.contact_model and context.contact is None:
            contact = estimate.mean(
                estimate.after_rows(config.contact_fit, fitted.contact_prior, params.label_scale, (x, y, w))
            )
        if not config.coupled:
            psi = object_model.basis(params, x, config.object, contact)
            a = least_squares.ridge(psi, y / params.label_scale, mean, config.ridge, weights=w)
            return least_squares.cap_norm(a, NORM_CAP), contact
        phi = object_model.design_matrix(params, x, config.object, contact)
        a, _ = least_squares.posterior(
            phi, y, mean=mean.reshape(-1), covariance=fitted.prior_covariance, noise=fitted.noise, weights=w
        )
        return a.reshape(mean.shape), contact

    def predict(
        state: tuple[Float[Array, "m K"], Float[Array, "p"]], x: Float[Array, "*batch n"], time: Float[Array, "*batch"]
    ) -> Float[Array, "*batch m"]:
        return object_model.predict(params, state[0], x, config.object, contact=state[1])

    return Predictor(jax.jit(adapt), predict)


def prior_of(fitted: ObjectFit, config: DaimlConfig) -> Predictor:
    """Predictor of the same psi before contact, with the prior coefficients and the mean contact parameters."""
    prior = jnp.asarray(fitted.prior_mean), jnp.mean(jnp.asarray(fitted.contact_prior), axis=0)
    return from_fit(fitted, config)._replace(adapt=lambda context: prior)


def trained(job: Job, config: DaimlConfig) -> tuple[ObjectFit, DaimlConfig]:
    """psi, trained with ``config`` and the settings of the job or read from its checkpoint, and all settings."""
    config = daiml_config(job, config)
    return daiml.fit_samples(job.train.samples, job.validation.samples, config, out_dir=job.directory), config


def _beside(job: Job, part: str) -> Path | None:
    """The directory of a part of a fit, beside that of the job, so that all parts share the contact parameters."""
    return None if job.directory is None else job.directory.with_name(f"{job.directory.name}-{part}")
