"""Weights: one safetensors file with all parameters that a controller needs, and its config in the header."""

from __future__ import annotations

import os
from dataclasses import asdict
from importlib import metadata
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Key, single_precision
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.dynamics import core, object_model
from shmoo_mjx.dynamics.core import CoreConfig, Params
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.dynamics.robot_model import RobotConfig
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import adaptation, contact_prior, estimate, least_squares, serialisation
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.learning.object_fit import ObjectFit
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.learning.robot_fit import RobotFit

SCHEMA_VERSION = 8
"""Version of the file format. It increases when a field changes its meaning or its name."""


class Weights(NamedTuple):
    """A trained model for roll-outs and adaptation."""

    params: Params
    """Parameters of the dynamics model, with the prior mean as coefficients."""
    prior_covariance: Float[Array, "n n"]
    """P0 of Eq. 8, the covariance of the prior, n = 3 K."""
    noise: Float[Array, "3 3"]
    """Residual covariance of one sample, R dt of Eq. 8."""
    contact_prior: Float[Array, "M p"]
    """Draws from the prior of the contact parameters (`contact_prior.draws`). Used only if
    config.object.contact_model."""
    config: CoreConfig
    """Static options of the dynamics model."""
    info: dict[str, Any]
    """Origin of each part (`learning.train.origin`) and scores; valid JSON."""


@single_precision
def untrained(config: CoreConfig | None = None, seed: int = 0) -> Weights:
    """Untrained weights, to be completed with `with_robot` and `with_object`."""
    config = config or CoreConfig()
    n = 3 * config.object.functions
    params = core.init(jax.random.key(seed), config)
    prior = jnp.tile(params.contact, (contact_prior.COUNT, 1))
    return Weights(params, jnp.eye(n), jnp.eye(3), prior, config, {})


@single_precision
def prior_state(
    weights: Weights,
    config: EstimateConfig | None = None,
    key: Key[Array, ""] | None = None,
    kind: str | None = None,
) -> LearnerState:
    """The estimate before the first contact, which equals the prior.

    Args:
        weights: trained weights.
        config: settings of the particle filter.
        key: random key of the particles.
        kind: kind of the object by its appearance (`contact_prior.of_kind`).
    """
    if weights.config.object.contact_model:
        return estimate.init(config or EstimateConfig(), contact_prior.of_kind(weights.contact_prior, kind), key)
    return adaptation.init(weights.params.coefficients, weights.prior_covariance, weights.noise)


@single_precision
def posterior_from_recording(
    weights: Weights,
    inputs: Float[Array, "N 13"],
    labels: Float[Array, "N 3"],
    sample_weights: Float[Array, "N"],
) -> LearnerState:
    """The estimate from a whole recording of an object.

    It is the posterior over the contact parameters or, without the contact model, a* of Eq. 5 given the prior.

    Args:
        weights: trained weights.
        inputs: inputs in the order of OBJECT_INPUTS.
        labels: accelerations in {O} [m/s^2, m/s^2, rad/s^2].
        sample_weights: weight of each sample; 0 if it does not count.
    """
    params, shape, scale = weights.params, weights.config.object, weights.params.object.label_scale
    if shape.contact_model:
        return estimate.after_rows(EstimateConfig(), weights.contact_prior, scale, (inputs, labels, sample_weights))
    phi = object_model.design_matrix(params.object, inputs, shape, params.contact)
    mean, _ = least_squares.posterior(
        phi,
        labels,
        mean=params.coefficients.reshape(-1),
        covariance=weights.prior_covariance,
        noise=weights.noise,
        weights=sample_weights,
    )
    state = adaptation.init(params.coefficients, weights.prior_covariance, weights.noise)
    return state._replace(mean=mean)


def with_robot(weights: Weights, fit: RobotFit, config: RobotConfig | None = None) -> Weights:
    """The weights with a newly trained R.

    ``config`` is the structure of R; by default it does not change.
    """
    params = weights.params._replace(robot=fit.params)
    info = weights.info | {"robot_score": float(fit.score)}
    core_config = _replace(weights.config, robot=config or weights.config.robot)
    return weights._replace(params=params, config=core_config, info=info)


@single_precision
def with_object(weights: Weights, fit: ObjectFit) -> Weights:
    """The weights with a newly trained psi and its prior."""
    prior = jnp.asarray(fit.contact_prior)
    contact = jnp.mean(prior, axis=0)
    params = weights.params._replace(object=fit.params, coefficients=jnp.asarray(fit.prior_mean), contact=contact)
    info = weights.info | {"object_score": float(fit.score)}
    core_config = _replace(weights.config, object=fit.config)
    return Weights(params, jnp.asarray(fit.prior_covariance), jnp.asarray(fit.noise), prior, core_config, info)


def save_weights(path: str | os.PathLike[str], weights: Weights) -> None:
    """Write the weights to one file, atomically."""
    notes = {
        "schema_version": SCHEMA_VERSION,
        "config": asdict(weights.config),
        "info": weights.info,
        "versions": {"shmoo-mjx": metadata.version("shmoo-mjx"), "jax": jax.__version__},
    }
    serialisation.save_tree(path, _arrays(weights), notes)


@single_precision
def load_weights(path: str | os.PathLike[str] | None = None) -> Weights:
    """Read a file written by `save_weights`, by default the weights that come with the package.

    Raises:
        ShmooError: the file is missing, damaged or of another schema version, its arrays do not fit its config, or a
            value is invalid (not finite, or no covariance).
    """
    path = asset(WEIGHTS) if path is None else path
    notes = serialisation.read_notes(path)
    version = notes.get("schema_version")
    if version != SCHEMA_VERSION:
        raise ShmooError(
            f"{path}: field 'schema_version' is {version}, this version reads {SCHEMA_VERSION}; train again."
        )
    try:
        config, info = _config(notes["config"]), dict(notes["info"])
        like = jax.eval_shape(lambda: _arrays(untrained(config)))
    except (KeyError, TypeError, ValueError) as error:
        raise ShmooError(f"{path}: field 'config' or 'info' can not be read ({error}); train again.") from None
    tree, _ = serialisation.load_tree(path, like)
    _check_values(path, tree)
    arrays = jax.tree.map(jnp.asarray, tree)
    return Weights(**arrays, config=config, info=info)


def _check_values(path: str | os.PathLike[str], tree: dict[str, Any]) -> None:
    """Raise ShmooError for values that no training produces. Undetected, they would give a robot that does not move."""
    for key, leaf in jax.tree_util.tree_leaves_with_path(tree):
        if not np.isfinite(leaf).all():
            name = jax.tree_util.keystr(key, simple=True, separator=".")
            raise ShmooError(f"{path}: field '{name}' holds values that are not finite; train again.")
    if not (tree["params"].object.label_scale > 0).all():
        raise ShmooError(f"{path}: field 'params.object.label_scale' must be positive; train again.")
    for name in ("prior_covariance", "noise"):
        # Rounding to single precision can make eigenvalues slightly negative.
        if np.linalg.eigvalsh(np.asarray(tree[name], float)).min() < -1e-5 * np.abs(tree[name]).max():
            raise ShmooError(f"{path}: field '{name}' is no covariance (it has a negative eigenvalue); train again.")


def _arrays(weights: Weights) -> dict[str, Any]:
    return {name: getattr(weights, name) for name in ("params", "prior_covariance", "noise", "contact_prior")}


def _replace(config: CoreConfig, **changes: Any) -> CoreConfig:
    from dataclasses import replace

    return replace(config, **changes)


def _config(values: dict[str, Any]) -> CoreConfig:
    values = dict(values)
    robot, thing = dict(values.pop("robot")), dict(values.pop("object"))
    robot["hidden"], thing["hidden"] = tuple(robot["hidden"]), tuple(thing["hidden"])
    return CoreConfig(robot=RobotConfig(**robot), object=ObjectConfig(**thing), **values)
