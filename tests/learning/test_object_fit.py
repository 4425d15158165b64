"""What `fit` returns adapts, predicts and can be kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

import shmoo_mjx as shmoo
from shmoo_mjx.data import store
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import daiml, weights
from shmoo_mjx.learning.estimate import ObjectEstimate
from shmoo_mjx.learning.object_fit import ObjectFit, load_fit
from shmoo_mjx.learning.samples import samples_from_dataset


def condition(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two labels that obey a linear law of the condition's own, of four inputs."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(120, 4))
    return x, x @ rng.normal(size=(4, 2))


@pytest.fixture(scope="module")
def fitted() -> ObjectFit:
    train, held_out = ({str(i): condition(i) for i in part} for part in (range(12), range(12, 16)))
    return shmoo.fit(train, held_out, shmoo.DaimlConfig(epochs=2, epoch_updates=60, adapt_samples=60))


def error(fit: ObjectFit, x: np.ndarray, y: np.ndarray) -> float:
    return float(np.mean((fit.predict(x) - y) ** 2) / np.var(y))


@pytest.mark.slow
def test_it_adapts_to_a_condition_it_has_not_seen(fitted: ObjectFit) -> None:
    x, y = condition(99)
    assert fitted.predict(x).shape == (120, 2)
    few, more = fitted.adapt(x[:5], y[:5]), fitted.adapt(x[:60], y[:60])
    assert error(more, x[60:], y[60:]) < 0.05 < 0.5 < error(fitted, x[60:], y[60:])
    assert error(more, x[60:], y[60:]) < error(few, x[60:], y[60:])
    spreads = [np.trace(f.prior_covariance) for f in (fitted, few, more)]
    assert spreads[0] > spreads[1] > spreads[2] > 0


def test_adapting_twice_is_adapting_to_both(fitted: ObjectFit) -> None:
    x, y = condition(7)
    once, twice = fitted.adapt(x[:40], y[:40]), fitted.adapt(x[:20], y[:20]).adapt(x[20:40], y[20:40])
    np.testing.assert_allclose(twice.predict(x), once.predict(x), atol=0.02)


def test_what_is_saved_is_what_is_loaded(fitted: ObjectFit, tmp_path: Path) -> None:
    x, y = condition(3)
    adapted = fitted.adapt(x, y)
    adapted.save(tmp_path / "mine.safetensors")
    loaded = shmoo.load_fit(tmp_path / "mine.safetensors")
    jax.tree.map(np.testing.assert_array_equal, loaded[:4], adapted[:4])
    assert (loaded.config, loaded.score, loaded.history) == (adapted.config, adapted.score, adapted.history)
    np.testing.assert_array_equal(loaded.predict(x), adapted.predict(x))
    np.testing.assert_array_equal(loaded.adapt(x, y).prior_mean, adapted.adapt(x, y).prior_mean)


@pytest.mark.slow
def test_the_shipped_psi_adapts_as_weights_do(synthetic_dataset: store.Dataset, tmp_path: Path) -> None:
    """With the contact model, whose parameters are estimated."""
    made = weights.load_weights()
    known = made.params.coefficients, made.prior_covariance, made.noise
    fit = ObjectFit(made.params.object, *known, 0.0, [], made.contact_prior, made.config.object)
    fit.save(tmp_path / "psi.safetensors")
    fit = load_fit(tmp_path / "psi.safetensors")
    rows = samples_from_dataset(synthetic_dataset.chosen([0]))
    x, y, w = (a[0][:100] for a in rows[:3])
    expected = weights.posterior_from_recording(made, x[w > 0], y[w > 0], w[w > 0])
    adapted = fit.adapt(x[w > 0], y[w > 0])
    assert isinstance(expected, ObjectEstimate)
    own, told = np.median(adapted.contact_prior, axis=0), np.median(expected.parameters, axis=0)
    np.testing.assert_allclose(own, told, atol=0.2)
    assert error(adapted, x, y) < error(fit, x, y)


@pytest.mark.parametrize(
    ("x", "y", "named"),
    [
        (np.ones((5, 3)), np.ones((5, 2)), "x"),
        (np.ones(4), np.ones((5, 2)), "x"),
        (np.ones((5, 4)), np.ones((5, 3)), "y"),
        (np.ones((5, 4)), np.ones((4, 2)), "5 rows"),
        (np.ones((0, 4)), np.ones((0, 2)), "0 rows"),
        (np.full((5, 4), np.nan), np.ones((5, 2)), "x"),
        (np.ones((5, 4)), np.full((5, 2), np.inf), "y"),
    ],
)
def test_arrays_of_another_form_are_refused(fitted: ObjectFit, x: np.ndarray, y: np.ndarray, named: str) -> None:
    with pytest.raises(ShmooError, match=named):
        fitted.adapt(x, y)


def test_other_files_are_refused(tmp_path: Path, fitted: ObjectFit) -> None:
    with pytest.raises(ShmooError, match="there is no such file"):
        load_fit(tmp_path / "none.safetensors")
    weights.save_weights(tmp_path / "weights.safetensors", weights.untrained())
    with pytest.raises(ShmooError, match=r"ObjectFit\.save"):
        load_fit(tmp_path / "weights.safetensors")
    fitted.save(tmp_path / "fit.safetensors")
    whole = (tmp_path / "fit.safetensors").read_bytes()
    (tmp_path / "fit.safetensors").write_bytes(whole[:-40])
    with pytest.raises(ShmooError, match="damaged"):
        load_fit(tmp_path / "fit.safetensors")
    with pytest.raises(ShmooError, match="schema_version"):
        fitted.save(tmp_path / "fit.safetensors")
        weights.load_weights(tmp_path / "fit.safetensors")


def test_the_config_says_what_was_left_out(fitted: ObjectFit) -> None:
    assert fitted.config == replace(
        daiml.DaimlConfig().object, last_wrench=True, contact_model=False, equivariant=False
    )
