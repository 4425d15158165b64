"""No random number is used twice: bits are drawn from a key once, and no other key comes of it.

The programs run with a generator that reports what is done with each key. ``fold_in(key, i)`` is ``split(key, n)[i]``,
so that keys that are made in different ways can be the same one.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from jax.extend.random import define_prng_impl

from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.learning.daiml import DaimlConfig, fit
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.plant.engine_mjx import MjxEngine
from shmoo_mjx.plant.randomize import Ranges, _draw

NEW, WRAP = jax.random.key, jax.random.wrap_key_data
DRAWN: Counter[tuple[int, ...]] = Counter()
"""How often bits were drawn from a key."""
PARENTS: set[tuple[int, ...]] = set()
"""Keys that others were made of."""


def _draw_bits(key: Any) -> None:
    DRAWN[tuple(np.asarray(key).tolist())] += 1


def _make_keys(key: Any) -> None:
    PARENTS.add(tuple(np.asarray(key).tolist()))


def _plain(key: jax.Array) -> jax.Array:
    return WRAP(key, impl="threefry2x32")


def _split(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    jax.debug.callback(_make_keys, key)
    return jax.random.key_data(jax.random.split(_plain(key), shape))


def _bits(key: jax.Array, width: int, shape: tuple[int, ...]) -> jax.Array:
    jax.debug.callback(_draw_bits, key)
    return jax.random.bits(_plain(key), shape, f"uint{width}")


def _fold_in(key: jax.Array, data: Any) -> jax.Array:
    jax.debug.callback(_make_keys, key)
    return jax.random.key_data(jax.random.fold_in(_plain(key), data))


REPORTING = define_prng_impl(
    key_shape=(2,),
    seed=lambda seed: jax.random.key_data(NEW(seed, impl="threefry2x32")),
    split=_split,
    random_bits=_bits,
    fold_in=_fold_in,
    name="reporting",
    tag="rep",
)


@pytest.fixture
def reused(monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[Any]]:
    """Gives the keys that were used twice since the test began, or since it was asked last."""

    def found() -> list[Any]:
        jax.effects_barrier()
        twice = [(key, count) for key, count in DRAWN.items() if count > 1 or key in PARENTS]
        drawn = len(DRAWN)
        DRAWN.clear()
        PARENTS.clear()
        assert drawn, "nothing was drawn"
        return twice

    DRAWN.clear()
    PARENTS.clear()
    # The default generator can only be one of JAX's own.
    for name in ("key", "wrap_key_data"):
        monkeypatch.setattr(jax.random, name, partial(getattr(jax.random, name), impl=REPORTING))
    return found


@pytest.mark.parametrize(
    "wrong",
    [
        lambda key: (jax.random.normal(key), jax.random.uniform(key)),
        lambda key: (jax.random.normal(jax.random.split(key)[1]), jax.random.normal(jax.random.fold_in(key, 1))),
        lambda key: [jax.random.normal(jax.random.fold_in(key, 0)) for _ in range(2)],
        lambda key: (jax.random.normal(key), jax.random.normal(jax.random.fold_in(key, 1))),
        # It splits its key into two itself.
        lambda key: (jax.random.randint(key, (), 0, 9), jax.random.randint(jax.random.fold_in(key, 1), (), 0, 9)),
    ],
)
def test_every_kind_of_reuse_is_found(wrong: Callable[[Any], Any], reused: Callable[[], list[Any]]) -> None:
    jax.jit(wrong)(jax.random.key(0))
    assert reused()


def test_right_use_is_not_found_fault_with(reused: Callable[[], list[Any]]) -> None:
    def right(key: Any) -> Any:
        a, b = jax.random.split(key)
        return jax.random.normal(a, (3,)), [jax.random.uniform(jax.random.fold_in(b, i)) for i in range(3)]

    jax.jit(right)(jax.random.key(0))
    assert not reused()


@pytest.mark.slow
def test_pushing(reused: Callable[[], list[Any]]) -> None:
    """The plans of a push, and the planning stage's roll-outs between them."""
    config = pose_push_config()
    config = replace(config, control=replace(config.control, num_rollouts=8, horizon=3))
    controller, half = PushController(load_weights(), config), np.array([0.3, 0.25])
    zero = np.zeros(3)
    seen = ObjectObservation(zero, zero, zero[:2], zero[:2], np.array([0.8, 0, 0]), zero, zero, np.array(True))
    floor = LocalDistanceField(np.full((4, 4), 9.0, np.float32), np.full(3, -20, np.float32), np.float32(10.0))
    state = controller.init(seen, faces_of(half)[0], half, jax.random.key(3))
    for _ in range(3):
        goal = np.array([1.5, 0, 0])
        _, state, _ = controller.step(state, seen, goal=goal, last_u=zero, half_extents=half, clearance=floor)
        controller.planning_rollouts(state, np.array([1.5, 0, 0]), floor, half)
    assert not reused()


@pytest.mark.slow
def test_training_of_psi(reused: Callable[[], list[Any]]) -> None:
    rng = np.random.default_rng(0)
    data = {str(i): (rng.normal(size=(40, 4)), rng.normal(size=(40, 2))) for i in range(5)}
    held_out = {"4": data.pop("4")}
    fit(data, held_out, DaimlConfig(epochs=2, epoch_updates=3, conditions=3, windows=4, adapt_samples=16))
    assert not reused()


@pytest.mark.slow
def test_training_of_r(reused: Callable[[], list[Any]], synthetic_dataset: Any) -> None:
    from shmoo_mjx.learning.robot_fit import RobotFitConfig, train_robot

    train_robot(synthetic_dataset, None, RobotFitConfig(batch=8, windows=4, epochs=2, epoch_updates=3, horizon=2))
    assert not reused()


@pytest.mark.slow
def test_baselines(reused: Callable[[], list[Any]], synthetic_dataset: Any) -> None:
    from shmoo_mjx.evaluation.baselines import METHODS, Budget, Job, recordings

    split = synthetic_dataset.split
    for name in ("mlp", "gru"):
        job = Job(recordings(split("train")), recordings(split("validation")), {}, Budget(2, 2, 2), 0, 100)
        METHODS[name].fit(replace(job, setting=METHODS[name].settings[0]))
        assert not reused(), name


def test_domain_randomisation(reused: Callable[[], list[Any]]) -> None:
    jax.vmap(lambda key: _draw(key, Ranges(), 9))(jax.random.split(jax.random.key(1), 3))
    assert not reused()


def sweep_config(**changes: Any) -> Any:
    from shmoo_mjx.sweep.config import SweepConfig

    controllers = {"plain": {"kind": "quasi_static"}}
    vary = {"noise.position": 0.003}
    return SweepConfig.model_validate({"worlds": 2, "seconds": 2, "vary": vary, "controllers": controllers, **changes})


def test_each_world_of_a_sweep_has_streams_of_its_own() -> None:
    from shmoo_mjx.sweep import worlds
    from shmoo_mjx.sweep.simulate import Stream, key_of

    config, found = sweep_config(), []
    for family in ("box", "cart"):
        drawn = [worlds.draw(config, family, i) for i in range(2)]
        scene = worlds.scene_of(drawn[0])
        given = worlds.set_up(config, drawn, MjxEngine([scene]).model, scene)
        for stream, sample in itertools.product(Stream, range(3)):
            keys = jax.vmap(lambda one, stream=stream, sample=sample: key_of(one, stream, sample))(given)
            found += jax.random.key_data(keys).tolist()
    assert len(set(map(tuple, found))) == len(found) == 2 * 2 * len(Stream) * 3


@pytest.mark.slow
def test_a_sweep(reused: Callable[[], list[Any]]) -> None:
    from shmoo_mjx.sweep import worlds
    from shmoo_mjx.sweep.simulate import Batches

    config = sweep_config()
    Batches(config, "box", "plain", load_weights()).run([worlds.draw(config, "box", i) for i in range(2)])
    assert not reused()
