"""Adaptation with the shipped weights over long random, adversarial and recorded sequences: it can't be poisoned.

300 steps in the fast form, 100,000 (almost three hours of contact) in the slow one.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.data.collect import CollectConfig, collect
from shmoo_mjx.dynamics import object_model
from shmoo_mjx.dynamics.core import CoreConfig
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning import online
from shmoo_mjx.learning.adaptation import AdaptState
from shmoo_mjx.learning.estimate import Sighting
from shmoo_mjx.learning.online import Transition
from shmoo_mjx.learning.samples import samples_from_dataset
from shmoo_mjx.learning.weights import Weights, load_weights, prior_state, untrained
from shmoo_mjx.types import DT

SIZE = jnp.array([0.3, 0.3, 0.5, 40.0, 40.0, 10.0, 0.3, 0.3, 0.5, 40.0, 40.0, 10.0, 0.5])
"""What the 13 inputs are about, twists and wrenches now and a sample ago; nothing depends on their exact order."""
KINDS = ["random", "adversarial", "broken", "silent", "recorded"]


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


def transitions(inputs: jax.Array, labels: jax.Array) -> Transition:
    """The samples, and an object that moves as they say."""
    twist = inputs[:, :3] + DT * labels
    yaw = jnp.cumsum(DT * inputs[:, 2])
    pose = jnp.concatenate([jnp.cumsum(DT * se2.rotate(inputs[:, :2], yaw), axis=0), yaw[:, None]], axis=-1)
    still = jnp.zeros(len(inputs))
    size = jnp.maximum(jnp.abs(inputs[:, 9]), 0.2)
    seen = Sighting(pose, se2.rotate(twist, yaw), still, still < 1, se2.rotate(inputs[:, 3:6], yaw), size)
    return Transition(inputs, labels, still < 1, seen)


@cache
def made(printed: bool) -> Weights:
    return untrained(CoreConfig(object=ObjectConfig.paper())) if printed else load_weights()


PROBE = SIZE * jax.random.normal(jax.random.key(1), (20, 13))


@cache
def learned(printed: bool) -> Any:
    """samples -> state at the end, predictions for the probes after each sample ``[T, 20, 3]``."""
    weights = made(printed)
    shape, learner = weights.config.object, online.learner(weights.config.object)

    def one(known: Any, sample: Transition) -> tuple[Any, jax.Array]:
        known = learner.adapt(known, weights.params, sample)
        own = learner.params_for_rollout(known, weights.params)
        return known, object_model.predict(own.object, own.coefficients, PROBE, shape, contact=own.contact)

    start = prior_state(weights)
    return jax.jit(lambda samples: jax.lax.scan(one, start, transitions(*samples)))


@pytest.mark.slow
@pytest.mark.parametrize("printed", [False, True], ids=["posterior", "Eq. 8"])
@pytest.mark.parametrize("kind", KINDS)
def test_minutes_of_anything_leave_it_sound(kind: str, printed: bool, synthetic_dataset: store.Dataset) -> None:
    check_sound(printed, recorded(synthetic_dataset, 300) if kind == "recorded" else sequences(kind, 300))


@pytest.mark.slow
@pytest.mark.parametrize("printed", [False, True], ids=["posterior", "Eq. 8"])
@pytest.mark.parametrize("kind", KINDS)
def test_hours_of_anything_leave_it_sound(kind: str, printed: bool, tmp_path: Path) -> None:
    if kind == "recorded":
        collect(tmp_path, CollectConfig(train=2, validation=0, episodes=4))
    check_sound(printed, recorded(store.read(tmp_path), 100_000) if kind == "recorded" else sequences(kind, 100_000))


def check_sound(printed: bool, samples: tuple[jax.Array, jax.Array]) -> None:
    """Finite and bounded predictions, and a positive definite covariance."""
    end, predicted = learned(printed)(samples)
    # A label of 20 m/s^2 is as much as an object of 2 kg gets from the robot's whole strength.
    assert np.isfinite(predicted).all() and np.abs(predicted).max() < 1e3
    assert all(np.isfinite(value) for value in online.summary(end).values())
    if isinstance(end, AdaptState):
        covariance = np.asarray(end.covariance, float)
        scale = 1 / np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance * np.outer(scale, scale)).min() > 0
