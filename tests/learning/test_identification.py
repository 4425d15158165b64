"""Contact models whose parameters are known, identified from what they did."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.learning import identification
from shmoo_mjx.learning.identification import IdentificationConfig, OnlineConfig
from shmoo_mjx.types import DT

CONFIG = IdentificationConfig(noise=0.3, groups=2, starts=64, refined=2, stride=1, rounds=2)
NAMES = list(contact_model.PARAMETERS)
SCALE = np.array([0.3, 0.3, 0.8], np.float32)
# Not jitted, each call would compile the contact model's loop anew.
acceleration = jax.jit(contact_model.acceleration)
identify = jax.jit(identification.identify, static_argnums=0)
observe = jax.jit(identification.observe, static_argnums=0)


def drawn(log_mass: float, log_friction: float, rng: np.random.Generator, rows: int = 120) -> tuple[np.ndarray, ...]:
    """Parameters around these, and inputs and labels of such an object under pushes that hold and slide it."""
    guess = np.array(list(contact_model.PARAMETERS.values()))
    parameters = guess[:, 0] + 0.3 * guess[:, 1] * rng.normal(size=len(guess))
    parameters[NAMES.index("log_mass")] = log_mass + 0.2 * rng.normal()
    parameters[[NAMES.index(f"log_friction_{a}") for a in "xy"]] = log_friction + 0.1 * rng.normal()
    limit = np.exp(log_mass + log_friction) * contact_model.GRAVITY
    inputs = np.zeros((rows, 13))
    inputs[:, :3] = rng.normal(size=(rows, 3)) * [0.3, 0.3, 0.4] * (rng.random((rows, 1)) < 0.7)
    inputs[:, 3:6] = rng.normal(size=(rows, 3)) * (limit + 3.0) * [0.7, 0.7, 0.15]
    inputs[:, 9] = 0.4
    known, pushes = (jnp.asarray(x, jnp.float32) for x in (parameters, inputs.T))
    labels = np.asarray(acceleration(known, pushes)).T
    return parameters, inputs.astype(np.float32), labels


@pytest.mark.slow
def test_groups_are_found_and_an_unseen_object_is_identified() -> None:
    rng = np.random.default_rng(0)
    kinds = ((2.0, -0.8), (3.5, -4.0))
    training = [drawn(*kinds[i % 2], rng) for i in range(16)]
    inputs, labels = (np.stack([t[k] for t in training]) for k in (1, 2))
    scale = labels.reshape(-1, 3).std(axis=0)
    prior, found = identification.learn_prior(CONFIG, scale, inputs, labels, np.ones(inputs.shape[:2], np.float32))
    mass = NAMES.index("log_mass")
    truth = np.array([t[0][mass] for t in training])
    assert np.median(np.abs(found[:, mass] - truth)) < 0.15
    friction = np.sort(prior.mean[:, NAMES.index("log_friction_x")])
    np.testing.assert_allclose(friction, [-4.0, -0.8], atol=0.8)
    for kind in kinds:
        parameters, x, y = drawn(*kind, rng)
        told = identify(CONFIG, prior, scale, x[:60], y[:60], np.ones(60))
        said = np.asarray(acceleration(told, jnp.asarray(x[60:].T))).T
        left = np.sum(((said - y[60:]) / scale) ** 2) / np.sum(((y[60:] - y[60:].mean(axis=0)) / scale) ** 2)
        assert left < 0.1
        assert abs(float(told[mass]) - parameters[mass]) < 0.3


def test_what_was_not_felt_stays_as_training_objects_are() -> None:
    """No row counts: the mean of the likeliest group."""
    prior = identification.broad_prior()
    none = jnp.zeros((5, 3))
    told = identify(CONFIG, prior, jnp.ones(3), jnp.full((5, 13), 0.4), none, jnp.zeros(5))
    np.testing.assert_allclose(told, prior.mean[0], atol=1e-4)


def test_online_it_comes_close_and_forgets() -> None:
    """Sample by sample; then the same object with four times the friction."""
    rng = np.random.default_rng(3)
    online = OnlineConfig(window=80, memory=3.0)
    state = identification.prior_state(online, identification.broad_prior(), SCALE)
    friction = NAMES.index("log_friction_x")
    for log_friction in (-1.5, -0.2):
        parameters, inputs, labels = drawn(2.0, log_friction, rng)
        for x, y in zip(inputs, labels, strict=True):
            state = observe(online, state, x, y)
        assert abs(float(identification.best(state)[friction]) - parameters[friction]) < 0.3


def test_a_bad_sample_changes_nothing() -> None:
    online = OnlineConfig(window=5)
    state = identification.prior_state(online, identification.broad_prior(), SCALE)
    x, y = jnp.full(13, 0.4), jnp.ones(3)
    for bad in ((x.at[0].set(jnp.nan), y, True), (x, y.at[1].set(jnp.inf), True), (x, y, False)):
        after = observe(online, state, *bad)
        jax.tree.map(np.testing.assert_array_equal, after, state)


@pytest.mark.slow
def test_a_stretch_is_the_first_rows_that_count() -> None:
    """Short stretches are fitted on their own rows only, wherever rows that don't count lie between."""
    _, inputs, labels = drawn(2.0, -1.0, np.random.default_rng(1), 60)
    weights = (np.arange(60) % 3 > 0).astype(np.float32)
    rows = tuple(a[None] for a in (inputs, labels, weights))
    prior = jax.tree.map(jnp.asarray, identification.broad_prior())
    lengths = (0, 8, 20)
    found = identification.from_stretches(CONFIG, prior, SCALE, rows, lengths)
    starts = np.random.default_rng(CONFIG.seed).integers(0, 60, (1, 3))[0]
    for start, length, told in zip(starts, lengths, found[0], strict=True):
        turned = [np.roll(a, -start, axis=0)[:40] for a in (inputs, labels, weights)]
        counted = turned[2] * (np.cumsum(turned[2]) <= length)
        expected = identify(CONFIG, prior, SCALE, turned[0], turned[1], counted)
        np.testing.assert_allclose(told, expected, atol=2e-2)


def test_noise_of_the_twist_is_not_taken_for_friction() -> None:
    """A cart on casters, pushed and let go; each twist is seen with noise of its own, the label is their difference."""
    online, rng = OnlineConfig(), np.random.default_rng(0)
    state = identification.prior_state(online, identification.broad_prior(), SCALE)
    rub = [NAMES.index(f"log_friction_{axis}") for axis in "xy"]
    truth = contact_model.guess().at[NAMES.index("log_mass")].set(3.3)
    truth = truth.at[np.array(rub)].set(np.log(0.1 / contact_model.GRAVITY))
    twist, seen, before = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(100):
        inputs = np.zeros(13, np.float32)
        inputs[:3], inputs[3], inputs[6:9], inputs[9] = twist, 6.0 if k % 25 < 10 else 0.0, before, 0.4
        twist = twist + np.asarray(acceleration(truth, jnp.asarray(inputs))) * DT
        now = twist + rng.normal(size=3) * [0.04, 0.04, 0.08]
        inputs[:3] = seen
        state = observe(online, state, inputs, ((now - seen) / DT).astype(np.float32))
        before, seen = seen, now
    drag = contact_model.GRAVITY * np.exp(float(identification.best(state)[rub[0]]))
    assert drag < 0.2, f"a drag of 0.1 m/s^2 is identified as {drag:.2f}"
