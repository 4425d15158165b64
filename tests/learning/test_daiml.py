"""DAIML learns a basis that a few rows of a new object are enough for, resumes, and repeats itself."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.dynamics import ObjectConfig, contact_model, object_model
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import scoring
from shmoo_mjx.evaluation.baselines.adaptive import from_fit, prior_of
from shmoo_mjx.evaluation.baselines.protocol import recordings
from shmoo_mjx.learning import daiml, multistep, training
from shmoo_mjx.learning.daiml import DaimlConfig
from shmoo_mjx.learning.samples import samples_from_dataset
from shmoo_mjx.types import DT

SMALL = DaimlConfig(
    object=ObjectConfig(hidden=(24, 24), contact_model=False),
    horizon=4,
    conditions=6,
    adapt_samples=32,
    windows=8,
    epochs=6,
    epoch_updates=60,
    fit_samples=100,
    learning_rate=5e-3,
)


@pytest.fixture(scope="module")
def trained(synthetic_dataset: store.Dataset) -> daiml.ObjectFit:
    return daiml.train_object(synthetic_dataset, None, SMALL)


@pytest.mark.slow
def test_unseen_objects_are_predicted(synthetic_dataset: store.Dataset, trained: daiml.ObjectFit) -> None:
    unseen, scale = recordings(synthetic_dataset.split("test")), trained.params.label_scale
    after, before = (
        scoring.average(scoring.score(predictor(trained, SMALL), unseen, scale, SMALL.fit_samples))
        for predictor in (from_fit, prior_of)
    )
    assert after["fvu"] < 0.15 and after["fvu"] < 0.5 * before["fvu"]
    assert after["pos_rmse_1s_m"] < 0.2 * before["pos_rmse_1s_m"]
    assert trained.history[-1][0] < trained.history[0][0]


@pytest.mark.slow
def test_the_prior_is_a_distribution(trained: daiml.ObjectFit) -> None:
    covariance, noise = np.asarray(trained.prior_covariance, float), np.asarray(trained.noise, float)
    n = SMALL.object.functions
    assert covariance.shape == (3 * n, 3 * n) and trained.prior_mean.shape == (3, n)
    np.linalg.cholesky(covariance)
    np.linalg.cholesky(noise)


@pytest.mark.slow
def test_killed_and_started_again_gives_the_same(
    tmp_path: Path, synthetic_dataset: store.Dataset, trained: daiml.ObjectFit
) -> None:
    def stop(progress: training.Progress) -> None:
        if progress.epoch == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        daiml.train_object(synthetic_dataset, tmp_path, SMALL, stop)
    seen: list[int] = []
    resumed = daiml.train_object(synthetic_dataset, tmp_path, SMALL, lambda p: seen.append(p.epoch))
    assert seen == [3, 4, 5, 6] and resumed.history == trained.history
    jax.tree.map(np.testing.assert_array_equal, resumed.params, trained.params)


@pytest.mark.parametrize("per_axis", [pytest.param(False, marks=pytest.mark.slow), True])
def test_open_loop_feeds_its_own_twist_back(per_axis: bool) -> None:
    config = ObjectConfig(hidden=(8,), per_axis=per_axis, linear_terms=True)
    params = object_model.init(jax.random.key(0), config)
    a = jax.random.normal(jax.random.key(1), (3, config.functions))
    inputs = jax.random.normal(jax.random.key(2), (4, 7, 13)).at[..., 9].set(0.4)
    contact = contact_model.guess()

    @jax.jit
    def predict(x: jax.Array) -> jax.Array:
        return object_model.predict(params, a, x, config, contact=contact)

    fed, twists = multistep.open_loop(predict, inputs)
    forced = predict(inputs)
    np.testing.assert_allclose(fed[:, 0], forced[:, 0], atol=1e-5)
    np.testing.assert_allclose(twists[:, 0], inputs[:, 0, :3])
    assert float(jnp.max(jnp.abs(fed[:, 1:] - forced[:, 1:]))) > 1e-3
    # Feeding the rolled-out twists in as if recorded gives the same accelerations.
    last = jnp.concatenate([inputs[:, :1, 6:9], twists[:, :-1]], axis=1)
    closed = jnp.concatenate([twists, inputs[..., 3:6], last, inputs[..., 9:]], axis=-1)
    np.testing.assert_allclose(predict(closed), fed, atol=1e-4)


def test_the_loss_counts_how_far_the_twist_has_drifted() -> None:
    """A law that depends on the wrench alone, predicted exactly and with a constant error along x."""
    steps, wrench = 6, jax.random.normal(jax.random.key(0), (3, 7, 3)) * jnp.array([1.0, 1.0, 0.0])
    twist = jnp.cumsum(wrench * DT, axis=1) - wrench * DT
    inputs = jnp.zeros((3, 7, 13)).at[..., :3].set(twist).at[..., 3:6].set(wrench).at[..., 9].set(0.4)
    windows = inputs[:, :steps], wrench[:, :steps], inputs[:, 1:]
    error, scale, precision = 0.2, jnp.array([0.5, 1.0, 1.0]), jnp.diag(jnp.array([2.0, 1.0, 1.0]))
    # After h steps the twist is off by h errors, of which Eq. 4's covariance expects sqrt(h).
    drift = (steps * (steps - 1) / 2 + 1) / steps
    for wrong in (0.0, error):

        def predict(x: jax.Array, wrong: float = wrong) -> jax.Array:
            return x[..., 3:6] + wrong * jnp.array([1.0, 0.0, 0.0])

        share = 2.0 * (wrong / 0.5) ** 2 / 3
        forced = multistep.loss(predict, windows, precision=precision, scale=scale, feed_back=False)
        fed = multistep.loss(predict, windows, precision=precision, scale=scale, one_step=0.5)
        np.testing.assert_allclose(forced, share, atol=1e-6)
        np.testing.assert_allclose(fed, (drift + 0.5) * share, atol=1e-5)


def test_design_matrix_is_the_model() -> None:
    for config in (ObjectConfig(hidden=(8,), per_axis=False), ObjectConfig(hidden=(8,))):
        params = object_model.init(jax.random.key(0), config)._replace(label_scale=jnp.array([1.0, 2.0, 3.0]))
        a = jax.random.normal(jax.random.key(1), (3, config.functions))
        x = jax.random.normal(jax.random.key(2), (5, 13)).at[..., 9].set(0.4)
        phi = object_model.design_matrix(params, x, config, contact_model.guess())
        expected = object_model.predict(params, a, x, config, contact=contact_model.guess())
        np.testing.assert_allclose(phi @ a.reshape(-1), expected, atol=1e-5)


@pytest.mark.slow
def test_a_condition_recorded_for_less_long_is_padded_with_what_the_contact_model_can_take(
    synthetic_dataset: store.Dataset,
) -> None:
    few = synthetic_dataset.chosen([0, 1])
    shorter = {name: values[:1] for name, values in few.arrays[0].items()}
    samples = samples_from_dataset(few._replace(arrays=[shorter, few.arrays[1]]))
    padding = samples.inputs[0, samples.labels.shape[1] // len(few.arrays[1]["size"]) :]
    assert len(padding) and not samples.weights[0, -len(padding) :].any()
    assert np.isfinite(contact_model.acceleration(contact_model.guess(), jnp.asarray(padding.T))).all()


@pytest.mark.slow
def test_any_arrays_will_do() -> None:
    rng = np.random.default_rng(0)

    def condition(n: int) -> tuple[np.ndarray, np.ndarray]:
        x = rng.normal(size=(n, 4))
        slope = rng.normal(size=2)
        return x, slope * np.sin(x[:, :1]) + x[:, 1:2]

    train = {str(i): condition(80 + i) for i in range(16)}
    config = replace(SMALL, object=ObjectConfig(hidden=(32, 32), functions=3), horizon=1, alpha=0.0, epochs=4)
    fitted = daiml.fit(train, {"v": condition(90), "w": condition(60)}, config)
    assert fitted.prior_mean.shape == (2, 3)
    assert fitted.score < 0.2


X, Y = np.ones((9, 4)), np.ones((9, 2))


@pytest.mark.parametrize(
    ("train", "validation", "told"),
    [
        ({}, {}, "no condition"),
        ({"a": (X, Y)}, {}, "no condition"),
        ({"a": (X, Y), "b": (X, Y[:8])}, {"v": (X, Y)}, "'b': x has 9 rows and y 8"),
        ({"a": (X[:0], Y[:0])}, {"v": (X, Y)}, "'a': x has 0 rows"),
        ({"a": (X[:, 0], Y)}, {"v": (X, Y)}, r"'a': x: .*\(9,\); give \[N, n\]"),
        ({"a": (X, Y), "b": (X[:, :3], Y)}, {"v": (X, Y)}, r"'b': x: .*\(9, 3\); give \[N, 4\]"),
        ({"a": (X, Y)}, {"v": (X, Y[:, :1])}, r"'v': y: .*\(9, 1\); give \[N, 2\]"),
        ({"a": (X, Y * np.nan)}, {"v": (X, Y)}, "'a': y: not all numbers are finite"),
        ({"a": (X, [[1.0], [1.0, 2.0]])}, {"v": (X, Y)}, "'a': y: is no array of numbers"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(train: dict, validation: dict, told: str) -> None:
    with pytest.raises(ShmooError, match=told):
        daiml.fit(train, validation, SMALL)
