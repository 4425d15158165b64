"""The measure of the comparison: known motions get known scores, and only later rows count."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.dynamics import features
from shmoo_mjx.evaluation import scoring
from shmoo_mjx.evaluation.baselines import Predictor, Recordings
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning.samples import Samples
from shmoo_mjx.types import DT

WHERE = features.slices(features.OBJECT_INPUTS)
SCALE = np.ones(3)


def law(x: Any) -> Any:
    """Pushed, and slowed in proportion to the twist."""
    return 0.05 * x[..., WHERE["wrench"]] - 0.4 * x[..., WHERE["object_twist"]]


TRUTH = Predictor(lambda context: jnp.zeros(()), lambda state, x, time: law(x))
NOTHING = Predictor(lambda context: jnp.zeros(()), lambda state, x, time: jnp.zeros((*x.shape[:-1], 3)))


def moving(episodes: int = 6, length: int = 80, seed: int = 0) -> Recordings:
    """One condition that obeys `law`, integrated as Eq. 1 says."""
    rng = np.random.default_rng(seed)
    n = episodes * length
    inputs, labels, poses = np.zeros((n, features.width(features.OBJECT_INPUTS))), np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        if i % length == 0:
            pose, twist, last = rng.normal(size=3), 0.1 * rng.normal(size=3), np.zeros(3)
        for name, value in (("object_twist", twist), ("wrench", 8 * rng.normal(size=3)), ("last_object_twist", last)):
            inputs[i, WHERE[name]] = value
        poses[i], labels[i] = pose, law(inputs[i])
        move = twist * DT + 0.5 * labels[i] * DT**2
        last, pose = twist, pose + se2.rotate(move, pose[2])
        twist = se2.rotate(twist + labels[i] * DT, -move[2])
    run = np.tile(np.arange(length, 0, -1), episodes)
    rows = Samples(inputs[None], labels[None], np.ones((1, n)), run[None])
    return Recordings(rows, DT * np.arange(n)[None], poses[None])


@pytest.fixture(scope="module")
def recorded() -> Recordings:
    return moving()


def test_the_truth_scores_nothing_and_nothing_scores_all(recorded: Recordings) -> None:
    right, still = scoring.score(TRUTH, recorded, SCALE), scoring.score(NOTHING, recorded, SCALE)
    assert set(right) == set(scoring.NAMES)
    assert right["mse"][0] < 1e-10 and right["fvu"][0] < 1e-9
    assert right["pos_rmse_3s_m"][0] < 1e-4 and right["yaw_rmse_3s_deg"][0] < 1e-2
    later = recorded.samples.labels[0, 250:]
    assert still["mse_yaw"][0] == pytest.approx(np.mean(later[:, 2] ** 2), rel=1e-4)
    expected = np.mean(later**2, axis=0).sum() / later.var(axis=0).sum()
    assert still["fvu"][0] == pytest.approx(expected, rel=1e-4)
    assert still["pos_rmse_3s_m"][0] > 0.02


def test_a_roll_out_sees_no_later_twist(recorded: Recordings) -> None:
    x, time = recorded.samples.inputs[0, 250:280].copy(), recorded.time[0, 250:280]
    clean = scoring.roll_out(TRUTH, jnp.zeros(()), jnp.asarray(x), jnp.asarray(time))
    x[1:, WHERE["object_twist"]] = 99.0
    x[1:, WHERE["last_object_twist"]] = 99.0
    np.testing.assert_allclose(scoring.roll_out(TRUTH, jnp.zeros(()), jnp.asarray(x), jnp.asarray(time)), clean)
    truth = se2.relative(recorded.pose[0, 250], recorded.pose[0, 279])
    np.testing.assert_allclose(np.asarray(clean)[29], truth, atol=1e-4)


def test_only_later_rows_count_and_only_first_ones_are_seen(recorded: Recordings) -> None:
    seen: list[int] = []

    def adapt(context: Any) -> Any:
        seen.append(context.inputs.shape[0])
        return jnp.mean(context.labels)

    spoilt = np.array(recorded.samples.labels)
    spoilt[:, :100] = 1e3
    changed = recorded._replace(samples=recorded.samples._replace(labels=spoilt))
    constant = Predictor(adapt, lambda state, x, time: jnp.zeros((*x.shape[:-1], 3)))
    found = scoring.score(constant, changed, SCALE, fit_samples=100)
    assert seen == [100]
    assert found["mse"][0] == pytest.approx(np.mean(recorded.samples.labels[0, 100:] ** 2), rel=1e-4)
    later = scoring.score(constant, changed, SCALE, fit_samples=100, from_sample=250)
    assert later["mse"][0] == pytest.approx(np.mean(recorded.samples.labels[0, 250:] ** 2), rel=1e-4)


def test_rows_that_do_not_count_do_not_count(recorded: Recordings) -> None:
    weights, labels = np.array(recorded.samples.weights), np.array(recorded.samples.labels)
    weights[0, 300:330], labels[0, 300:330] = 0.0, 1e3
    changed = recorded._replace(samples=recorded.samples._replace(weights=weights, labels=labels))
    assert scoring.score(TRUTH, changed, SCALE, roll_outs=False)["mse"][0] < 1e-10


def test_no_stretch_long_enough_is_not_a_number() -> None:
    found = scoring.score(TRUTH, moving(episodes=60, length=8), SCALE)
    assert np.isnan(found["pos_rmse_1s_m"][0]) and found["mse"][0] < 1e-10


def test_what_runs_away_is_infinitely_wrong(recorded: Recordings) -> None:
    """Not left out of the mean, which would flatter the method; rows that do not count do not matter."""
    weights = np.array(recorded.samples.weights)
    weights[0, 300:330] = 0.0
    changed = recorded._replace(samples=recorded.samples._replace(weights=weights))
    faster = Predictor(lambda c: jnp.zeros(()), lambda s, x, t: 1e20 * x[..., WHERE["object_twist"]] ** 3)
    found = scoring.score(faster, changed, SCALE)
    assert np.isinf(found["pos_rmse_3s_m"][0]) and np.isinf(found["yaw_rmse_3s_deg"][0])
    late = float(recorded.time[0, 315])

    def lost(s: Any, x: Any, t: Any) -> Any:
        return jnp.where((jnp.abs(t - late) < 0.05)[..., None], jnp.nan, TRUTH.predict(s, x, t))

    nowhere = Predictor(TRUTH.adapt, lost)
    assert np.isinf(scoring.score(nowhere, recorded, SCALE, roll_outs=False)["mse"][0])
    assert scoring.score(nowhere, changed, SCALE, roll_outs=False)["mse"][0] < 1e-10


@settings(max_examples=4, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_the_unit_of_the_labels_does_not_change_the_share(factor: float, shift: float) -> None:
    """Errors and labels stretched alike leave fvu alone; a scale common to all axes cancels."""
    recorded, k = moving(episodes=6), float(np.exp(factor))
    halved = Predictor(lambda c: jnp.zeros(()), lambda s, x, t: 0.5 * law(x) + shift)
    plain = scoring.score(halved, recorded, SCALE, roll_outs=False)["fvu"][0]
    stretched = recorded._replace(samples=recorded.samples._replace(labels=k * recorded.samples.labels))
    taller = Predictor(lambda c: jnp.zeros(()), lambda s, x, t: k * (0.5 * law(x) + shift))
    assert scoring.score(taller, stretched, k * SCALE, roll_outs=False)["fvu"][0] == pytest.approx(plain, rel=1e-3)
