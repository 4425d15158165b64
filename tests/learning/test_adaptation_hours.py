"""Adaptation with the shipped weights over long random, adversarial and recorded sequences: it can't be poisoned.

300 steps in the fast form, 100,000 (almost three hours of contact) in the slow one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.data.collect import CollectConfig, collect
from shmoo_mjx.dynamics import contact_model, object_model
from shmoo_mjx.learning import online
from shmoo_mjx.learning.adaptation import AdaptConfig, AdaptState
from shmoo_mjx.learning.samples import samples_from_dataset
from shmoo_mjx.learning.weights import Weights, load_weights, prior_state

RARER = ("adversarial", "silent", "recorded")
"""Kinds of sequences that the slow tests alone try."""
SIZE = jnp.array([0.3, 0.3, 0.5, 40.0, 40.0, 10.0, 0.3, 0.3, 0.5, 40.0, 40.0, 10.0, 0.5])
"""What the 13 inputs are about, twists and wrenches now and a sample ago; nothing depends on their exact order."""


def sequences(kind: str, length: int) -> tuple[jax.Array, jax.Array]:
    """Inputs ``[T, 13]`` and labels ``[T, 3]``."""
    keys = jax.random.split(jax.random.key(7), 4)
    inputs, labels = SIZE * jax.random.normal(keys[0], (length, 13)), jax.random.normal(keys[1], (length, 3))
    turn = jnp.arange(length)[:, None]
    if kind == "adversarial":
        # Always the opposite of what was just learned, as large as it is believed, from one single direction.
        inputs = jnp.where(turn % 7 < 5, inputs[:1], inputs)
        labels = 20.0 * jnp.sign(labels[:1]) * jnp.where(turn // 50 % 2 == 0, 1.0, -1.0)
    if kind == "broken":
        spoilt = jax.random.choice(keys[2], jnp.array([jnp.nan, jnp.inf, -jnp.inf, 1e38, 1e12]), (length, 13))
        inputs = jnp.where(jax.random.bernoulli(keys[3], 0.05, (length, 13)), spoilt, inputs)
        labels = jnp.where(turn % 11 == 0, spoilt[:, :3], labels)
    if kind == "silent":
        inputs, labels = jnp.zeros_like(inputs), jnp.zeros_like(labels)
    return inputs, labels


def recorded(dataset: store.Dataset, length: int) -> tuple[jax.Array, jax.Array]:
    """The recordings of a data set, one object after the other without a word, over and over."""
    samples = samples_from_dataset(dataset)
    inputs, labels = (jnp.asarray(x).reshape(-1, x.shape[-1]) for x in (samples.inputs, samples.labels))
    return jnp.resize(inputs, (length, 13)), jnp.resize(labels, (length, 3))


@pytest.fixture(scope="module")
def weights() -> Weights:
    return load_weights()


PROBE = SIZE * jax.random.normal(jax.random.key(1), (20, 13))
_COMPILED: dict[bool, Any] = {}


def learned(weights: Weights, coefficients: bool) -> Any:
    """(state, samples) -> state at the end, predictions for the first probe ``[T, 3]``, bodies ``[T, p]``."""
    config, shape, params = AdaptConfig(coefficients=coefficients), weights.config.object, weights.params.object

    def one(state: AdaptState, sample: tuple[jax.Array, jax.Array]) -> tuple[AdaptState, tuple[jax.Array, jax.Array]]:
        state = online.observe(config, state, params, shape, *sample)
        contact = online.contact_of(state)
        return state, (object_model.design_matrix(params, PROBE[0], shape, contact) @ state.mean, contact)

    def run(state: AdaptState, samples: tuple[jax.Array, jax.Array]) -> tuple[AdaptState, jax.Array, jax.Array]:
        end, (predicted, contacts) = jax.lax.scan(one, state, samples)
        return end, predicted, contacts

    return _COMPILED.setdefault(coefficients, jax.jit(run))


@pytest.mark.parametrize(
    "coefficients", [pytest.param(False, id="body"), pytest.param(True, id="body and Eq. 8", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "kind",
    ["random", "broken", *(pytest.param(k, marks=pytest.mark.slow) for k in ("adversarial", "silent", "recorded"))],
)
def test_minutes_of_anything_leave_it_sound(
    kind: str, coefficients: bool, weights: Weights, synthetic_dataset: store.Dataset
) -> None:
    some = recorded(synthetic_dataset, 300) if kind == "recorded" else sequences(kind, 300)
    check_sound(weights, coefficients, some)


@pytest.mark.slow
@pytest.mark.parametrize("coefficients", [False, True], ids=["body", "body and Eq. 8"])
@pytest.mark.parametrize("kind", ["random", "adversarial", "broken", "silent", "recorded"])
def test_hours_of_anything_leave_it_sound(kind: str, coefficients: bool, weights: Weights, tmp_path: Path) -> None:
    if kind == "recorded":
        collect(tmp_path, CollectConfig(train=2, validation=0, episodes=4))
    some = recorded(store.read(tmp_path), 100_000) if kind == "recorded" else sequences(kind, 100_000)
    check_sound(weights, coefficients, some)


def check_sound(weights: Weights, coefficients: bool, samples: tuple[jax.Array, jax.Array]) -> None:
    """Finite, bounded, a positive definite covariance, and other predictions not far from the prior's."""
    shape = weights.config.object
    end, predicted, contacts = learned(weights, coefficients)(prior_state(weights), samples)
    assert (
        np.isfinite(predicted).all()
        and np.isfinite(contacts).all()
        and contacts.shape[-1] == len(contact_model.PARAMETERS)
    )
    # A label of 20 m/s^2 is as much as an object of 2 kg gets from the robot's whole strength.
    assert np.abs(predicted).max() < 1e3
    covariance = np.asarray(end.covariance, float)
    scale = 1 / np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance * np.outer(scale, scale)).min() > 0
    before = prior_state(weights)
    params, contact = weights.params.object, online.contact_of(end)
    phis = jax.jit(jax.vmap(lambda x: object_model.design_matrix(params, x, shape, contact)))(PROBE)
    there, first = (np.abs(phis @ state.mean).max() for state in (end, before))
    assert there < 10 * first + 100.0
