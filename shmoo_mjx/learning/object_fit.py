"""A trained psi with its prior: adaptation to one object, prediction, and storage in a file."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, single_precision
from shmoo_mjx.dynamics import object_model
from shmoo_mjx.dynamics.contact_model import PARAMETERS
from shmoo_mjx.dynamics.object_model import ObjectConfig, ObjectParams
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import estimate, least_squares, serialisation
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.learning.samples import checked_pair, checked_rows

_ARRAYS = ("params", "prior_mean", "prior_covariance", "noise", "contact_prior")


class ObjectFit(NamedTuple):
    """A trained psi with a prior over all objects or, after `adapt`, with the posterior of one object."""

    params: ObjectParams
    """Parameters of psi."""
    prior_mean: Float[Array, "m K"]
    """Mean of the coefficients a."""
    prior_covariance: Float[Array, "n n"]
    """Covariance of the coefficients, n = m K. It couples the axes: data along x are informative about y and yaw."""
    noise: Float[Array, "m m"]
    """Residual covariance of one sample."""
    score: float
    """Best validation score, the mean of the one-step and open-loop scores (`daiml._validation_scores`). Lower is
    better."""
    history: list[tuple[float, float]]
    """(training loss, validation score) of each epoch."""
    contact_prior: Float[Array, "M p"]
    """Draws from the prior of the contact parameters. Used only if config.contact_model."""
    config: ObjectConfig
    """Structure of psi. `daiml.fit` disables requested options that need inputs of known meaning."""

    @single_precision
    def adapt(self, x: Float[Array, "N n_in"], y: Float[Array, "N m"]) -> ObjectFit:
        """The fit for one object, given N samples of it: the posterior replaces the prior (Eq. 5).

        Call it again on the result to add samples of the same object.

        Args:
            x: inputs, in the order and units of the training.
            y: labels, in the units of the training.

        Raises:
            ShmooError: x or y is not finite, or its shape differs from the training.
        """
        x, y = map(jnp.asarray, checked_pair("adapt", x, y, (self._inputs(), len(self.params.label_scale))))
        prior = self.contact_prior
        if self.config.contact_model:
            after = estimate.after_rows(EstimateConfig(), prior, self.params.label_scale, (x, y, jnp.ones(len(x))))
            prior = estimate.draw(after, jax.random.key(0), len(prior))
        adapted = self._replace(contact_prior=prior)
        phi = object_model.design_matrix(self.params, x, self.config, adapted._contact())
        mean, covariance = least_squares.posterior(
            phi, y, mean=self.prior_mean.reshape(-1), covariance=self.prior_covariance, noise=self.noise
        )
        return adapted._replace(prior_mean=mean.reshape(self.prior_mean.shape), prior_covariance=covariance)

    @single_precision
    def predict(self, x: Float[Array, "N n_in"]) -> Float[np.ndarray, "N m"]:
        """Predicted labels of N samples: psi a with the mean of a, in the units of the labels.

        Raises:
            ShmooError: x is not finite, or its shape differs from the training.
        """
        x = jnp.asarray(checked_rows("predict: x", x, self._inputs()))
        return np.asarray(object_model.predict(self.params, self.prior_mean, x, self.config, contact=self._contact()))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the fit to one safetensors file for `load_fit`, atomically."""
        notes = {"object_fit": asdict(self.config), "score": float(self.score), "history": self.history}
        shape = {"inputs": self._inputs(), "axes": len(self.params.label_scale), "draws": len(self.contact_prior)}
        serialisation.save_tree(path, {name: getattr(self, name) for name in _ARRAYS}, notes | shape)

    def _inputs(self) -> int:
        """Number of inputs of psi. Its network can have more or fewer inputs (`object_model.inputs_of`)."""
        return object_model.inputs_of(self.config, self.params.linear.shape[0], len(self.params.label_scale))

    def _contact(self) -> Array:
        return jnp.mean(jnp.asarray(self.contact_prior), axis=0)


@single_precision
def load_fit(path: str | os.PathLike[str]) -> ObjectFit:
    """Read a file written by `ObjectFit.save`.

    Raises:
        ShmooError: the file is missing or damaged, or does not hold an ObjectFit.
    """
    notes = serialisation.read_notes(path)
    try:
        told = dict(notes["object_fit"])
        config = ObjectConfig(**told | {"hidden": tuple(told["hidden"])})
        axes, draws = int(notes["axes"]), int(notes["draws"])
        score, history = float(notes["score"]), [(float(a), float(b)) for a, b in notes["history"]]
        make = lambda: object_model.init(jax.random.key(0), config, int(notes["inputs"]), axes)  # noqa: E731
        params = jax.eval_shape(make)
    except (KeyError, TypeError, ValueError) as error:
        raise ShmooError(f"{path}: is no fit that ObjectFit.save wrote ({error!r}); give one that is.") from None
    n, p = axes * config.functions, len(PARAMETERS)
    shapes = {"prior_mean": (axes, config.functions), "prior_covariance": (n, n), "noise": (axes, axes)}
    shapes["contact_prior"] = (draws, p)
    like: dict[str, Any] = {name: jax.ShapeDtypeStruct(shape, jnp.float32) for name, shape in shapes.items()}
    tree, _ = serialisation.load_tree(
        path, like | {"params": params, "contact_prior": jax.ShapeDtypeStruct((draws, p), jnp.float32)}
    )
    arrays = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), tree)
    return ObjectFit(**arrays, score=score, history=history, config=config)
