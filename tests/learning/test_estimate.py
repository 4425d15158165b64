"""The posterior over contact parameters: objects whose truth is known, and what can go wrong with a sample."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning import contact_prior, estimate, online
from shmoo_mjx.learning.estimate import EstimateConfig, ObjectEstimate, Sighting
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.types import DT

CONFIG = EstimateConfig(particles=512, lag=0.0)
PRIOR = contact_prior.draws(192)
SIZE = 0.42
MASS = contact_model.PARAMETERS.index("log_mass")
acceleration = jax.jit(contact_model.acceleration)
STEP = jax.jit(estimate.step, static_argnums=0)


def pushed(
    parameters: Any, forces: np.ndarray, late: int = 0, seed: int = 0, *, casters: np.ndarray | None = None
) -> list[Sighting]:
    """What is seen of an object from rest under ``forces [T]`` along x, whose poses arrive ``late`` samples late.

    ``casters`` are their rolling directions at the start, unit vectors in {O}.
    """
    parameters = jnp.asarray(parameters, jnp.float32)
    rng, twist, pose = np.random.default_rng(seed), np.zeros(3), np.zeros(3)
    poses, twists, seen = [pose], [twist], []
    for force in forces:
        inside, wrench = (se2.rotate(np.asarray(v), -pose[2]) for v in (twist, (force, 0.0, 0.0)))
        inputs = jnp.asarray([*inside, *wrench, 0.0, 0.0, 0.0, SIZE, 0.0, 0.0, 0.0], jnp.float32)
        change = np.asarray(acceleration(parameters, inputs, casters=casters)) * DT
        if casters is not None:
            casters = contact_model.turned(casters, parameters, inside + change / 2, SIZE)
        new = twist + se2.rotate(change, pose[2])
        pose, twist = pose + (twist + new) / 2 * DT, new
        poses.append(pose), twists.append(twist)
        then = max(len(poses) - 1 - late, 0)
        noisy = poses[then] + rng.normal(size=3) * [0.003, 0.003, 0.006] + late * DT * twists[then]
        age = np.asarray(late * DT)
        seen.append(Sighting(noisy, twists[then], age, np.array(True), np.array([force, 0.0, 0.0]), np.asarray(SIZE)))
    return seen


def after(
    samples: list[Sighting], state: ObjectEstimate | None = None, kind: str | None = None
) -> list[ObjectEstimate]:
    """The posterior after each sample."""
    state, found = state or estimate.init(CONFIG, contact_prior.of_kind(PRIOR, kind)), []
    for seen in samples:
        state = STEP(CONFIG, state, jax.tree.map(jnp.asarray, seen))
        found.append(state)
    return found


def assert_prior(state: ObjectEstimate) -> None:
    """The mean differs from that of the prior by what the number of particles explains."""
    chance = PRIOR.std(axis=0) / np.sqrt(CONFIG.particles)
    np.testing.assert_array_less(np.abs(estimate.mean(state) - PRIOR.mean(axis=0)), 5.0 * chance + 0.01)


def masses(states: list[ObjectEstimate]) -> np.ndarray:
    return np.exp([float(estimate.mean(state)[MASS]) for state in states])


def box(mass: float, friction: float) -> np.ndarray:
    return contact_prior.parameters_of(draw_condition("box", 3, {"mass": mass, "payload": 0.0, "friction": friction}))


def pulses(limit: float, count: int = 40) -> np.ndarray:
    """Forces that hold, slide and let go, around the friction."""
    return limit * np.tile([0.5, 0.9, 1.3, 1.4, 1.2, 0.8, 0.0, 0.0], count // 8)


@pytest.mark.parametrize("late", [pytest.param(0, marks=pytest.mark.slow), 1])
@pytest.mark.parametrize(("mass", "friction"), [(6.0, 0.4), (16.0, 0.3)])
def test_a_box_is_known_after_four_seconds_and_its_mass_never_jumps(mass: float, friction: float, late: int) -> None:
    states = after(pushed(box(mass, friction), pulses(mass * friction * 9.81), late))
    known = masses(states)
    assert mass / 1.5 < known[-1] < 1.5 * mass
    assert np.abs(np.diff(np.log(known[5:]))).max() < np.log(1.5)
    low, middle, high = estimate.quantiles(
        states[-1], contact_model.resistance(states[-1].parameters)[:, 0], (0.1, 0.5, 0.9)
    )
    assert low <= middle <= high and abs(np.log(middle / (mass * friction * 9.81))) < 0.2


def test_the_casters_of_a_pushed_cart_are_known_to_point_along_its_way() -> None:
    """They point anywhere at first, and stay as they are from one push to the next."""
    cart = contact_prior.parameters_of(draw_condition("cart", 3, {"mass": 20.0, "payload": 0.0, "locked": [False] * 4}))
    angles = np.random.default_rng(0).normal(0.0, 0.1, 4)
    there = np.stack([np.cos(angles), np.sin(angles)], axis=-1).astype(np.float32)
    states = after(pushed(cart, np.tile([*[12.0] * 6, *[0.0] * 4], 3), casters=there), kind="cart")
    before, later = (np.asarray(state.casters)[..., 0].mean() for state in (states[0], states[-1]))
    assert abs(before) < 0.1 and later > 0.95
    np.testing.assert_array_equal(estimate.relocated(states[-1]).casters, states[-1].casters)


def test_a_load_that_comes_on_the_way_is_found() -> None:
    light, heavy = box(6.0, 0.4), box(18.0, 0.4)
    before = after(pushed(light, pulses(6.0 * 0.4 * 9.81)))[-1]
    then = after(pushed(heavy, pulses(18.0 * 0.4 * 9.81, 80)), estimate.relocated(before))
    friction = np.asarray(contact_model.resistance(estimate.mean(then[-1])))[0]
    # Without the load it is a third; draws differ by up to 0.4.
    assert abs(np.log(friction / (18.0 * 0.4 * 9.81))) < 0.5


def test_an_object_that_nothing_touches_stays_the_prior() -> None:
    states = after(pushed(box(6.0, 0.4), np.zeros(20)))
    assert states[-1].log_weight.std() < 0.5
    assert_prior(states[-1])


@pytest.mark.parametrize("field", ["pose", "twist", "wrench", "age", "size"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_sample_that_is_not_finite_changes_nothing(field: str, bad: float) -> None:
    samples = pushed(box(6.0, 0.4), pulses(24.0, 8))
    state = after(samples)[-1]
    wrong = samples[-1]._replace(**{field: np.full(np.shape(getattr(samples[-1], field)), bad)})
    same = STEP(CONFIG, state, jax.tree.map(jnp.asarray, wrong))
    jax.tree.map(np.testing.assert_array_equal, same._replace(key=None), state._replace(key=None))


def test_what_has_lost_all_weight_begins_anew_and_says_so() -> None:
    samples = pushed(box(6.0, 0.4), pulses(24.0, 8))
    lost = after(samples)[-1]._replace(twist=jnp.full((CONFIG.particles, 3), jnp.nan))
    again = STEP(CONFIG, lost, jax.tree.map(jnp.asarray, samples[-1]))
    assert online.restarts(again) == 1 and all(
        np.isfinite(leaf).all() for leaf in jax.tree.leaves(again._replace(key=None))
    )
    assert_prior(again)


@pytest.mark.slow
def test_equal_keys_give_equal_estimates_and_mapping_changes_nothing() -> None:
    samples = pushed(box(6.0, 0.4), pulses(24.0, 8))
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *samples)
    start = jax.vmap(partial(estimate.init, CONFIG, PRIOR))(jax.random.split(jax.random.key(1), 2))

    @jax.jit
    def run(state: ObjectEstimate) -> ObjectEstimate:
        return jax.lax.scan(lambda s, seen: (estimate.step(CONFIG, s, seen), None), state, stacked)[0]

    both = jax.vmap(run)(start)
    for i in range(2):
        alone = run(jax.tree.map(lambda leaf, i=i: leaf[i], start))
        np.testing.assert_allclose(estimate.mean(both)[i], estimate.mean(alone), atol=1e-2)
    assert np.abs(np.diff(estimate.mean(both), axis=0)).max() > 1e-3


@pytest.mark.parametrize("family", FAMILIES)
def test_recorded_rows_tell_the_friction(family: str) -> None:
    parameters = contact_prior.parameters_of(
        draw_condition(family, 5, {} if family == "box" else {"locked": [False] * 4})
    )
    rng, limit = np.random.default_rng(0), float(contact_model.resistance(parameters)[0])
    rows = np.zeros((120, 13), np.float32)
    rows[:, 0] = 0.3 * rng.random(120) * (rng.random(120) < 0.7)
    rows[:, 3] = rng.random(120) * 2.0 * limit
    rows[:, 9] = SIZE
    labels = acceleration(jnp.asarray(np.repeat(parameters[:, None], 120, 1), jnp.float32), jnp.asarray(rows.T)).T
    scale, weights = jnp.array([0.3, 0.3, 0.8]), np.ones(120)
    after_rows = jax.jit(partial(estimate.after_rows, CONFIG, jnp.asarray(PRIOR), scale))
    found = estimate.mean(after_rows((rows, labels, weights)))
    assert abs(np.log(float(contact_model.resistance(found)[0]) / limit)) < 0.3
    none = estimate.mean(after_rows((rows, labels, 0 * weights)))
    np.testing.assert_allclose(none, estimate.mean(estimate.init(CONFIG, PRIOR)), atol=1e-5)


def test_draws_and_quantiles_are_those_of_the_weights() -> None:
    state = estimate.init(CONFIG, PRIOR)
    state = state._replace(log_weight=jnp.where(jnp.arange(CONFIG.particles) < 2, jnp.log(0.5), -jnp.inf))
    drawn = estimate.draw(state, jax.random.key(0), 200)
    first = np.asarray((drawn == state.parameters[0]).all(axis=1))
    assert 60 < first.sum() < 140 and (drawn[~first] == state.parameters[1]).all()
    values = jnp.arange(CONFIG.particles, dtype=jnp.float32)
    np.testing.assert_array_equal(estimate.quantiles(state, values, (0.1, 0.9)), [0.0, 1.0])


def test_what_looks_like_a_box_has_the_prior_of_boxes() -> None:
    boxes = contact_prior.of_kind(PRIOR, "box")
    assert boxes.shape == PRIOR.shape
    own = [contact_prior.parameters_of(draw_condition("box", contact_prior.FIRST_SEED + i)) for i in range(32)]
    both = np.concatenate([own, contact_prior.mirrored(np.array(own))])
    assert {tuple(row) for row in boxes.tolist()} == {tuple(row) for row in both.astype(np.float32).tolist()}
    assert contact_prior.of_kind(PRIOR, None) is PRIOR
    with pytest.raises(ShmooError, match="kind 'crate' is unknown"):
        contact_prior.of_kind(PRIOR, "crate")
    assert [contact_prior.kind_of(draw_condition(family, 0)) for family in FAMILIES] == list(FAMILIES)
