"""R learns, resumes and can be fine-tuned; the lean's constants are found."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.dynamics import RobotConfig, robot_model
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import robot_fit, training
from shmoo_mjx.learning.robot_fit import RobotFitConfig

SMALL = RobotFitConfig(robot=RobotConfig(hidden=(32, 32)), batch=128, epochs=5, epoch_updates=100, learning_rate=5e-3)


@pytest.mark.slow
def test_learns_base_and_force(synthetic_dataset: store.Dataset) -> None:
    fitted = robot_fit.train_robot(synthetic_dataset, None, SMALL)
    planar = fitted.per_output[[0, 1, 3, 4]]  # the synthetic robot does not turn
    assert np.all(planar < 0.1)
    np.testing.assert_allclose(fitted.params.lean.matrix, robot_model.lag(6.0, 0.7).matrix, atol=0.05)


@pytest.mark.slow
def test_killed_and_started_again_gives_the_same(tmp_path: Path, synthetic_dataset: store.Dataset) -> None:
    config = replace(SMALL, epochs=3, epoch_updates=10)
    whole = robot_fit.train_robot(synthetic_dataset, None, config)

    def stop(progress: training.Progress) -> None:
        if progress.epoch == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        robot_fit.train_robot(synthetic_dataset, tmp_path, config, progress=stop)
    resumed = robot_fit.train_robot(synthetic_dataset, tmp_path, config)
    assert resumed.history == whole.history
    jax.tree.map(np.testing.assert_array_equal, resumed.params, whole.params)


@pytest.mark.slow
def test_fine_tuning_starts_from_what_is_known(synthetic_dataset: store.Dataset) -> None:
    known = robot_fit.train_robot(synthetic_dataset, None, SMALL)
    brief = replace(SMALL, epochs=1, epoch_updates=5, learning_rate=1e-4)
    tuned = robot_fit.train_robot(synthetic_dataset, None, brief, start=known.params)
    fresh = robot_fit.train_robot(synthetic_dataset, None, brief)
    assert tuned.score < 1.2 * known.score < fresh.score


@pytest.mark.slow
def test_over_one_sample_a_roll_out_is_the_one_step_of_eq_7(synthetic_dataset: store.Dataset) -> None:
    config = replace(SMALL, horizon=1)
    params = robot_fit.train_robot(synthetic_dataset, None, replace(SMALL, epochs=1)).params
    # Hands that are off the face push nothing in a roll-out; here they stay on it.
    touching = [a | {"object_pose": a["robot_pose"] + np.float32([0.78, 0, 0])} for a in synthetic_dataset.arrays]
    rows = robot_fit.samples_from_dataset(synthetic_dataset._replace(arrays=touching))
    starts = np.flatnonzero(rows.following >= 1)
    rolled = robot_fit._rolled_out(config, params, jax.tree.map(jnp.asarray, rows), starts)
    base, force = robot_model.predict(params, rows.inputs[starts], SMALL.robot)
    error = jnp.concatenate([base, force], axis=-1) - rows.labels[starts]
    np.testing.assert_allclose(rolled, np.mean((error / params.output_scale) ** 2), rtol=2e-3)


@pytest.mark.slow
def test_roll_outs_stay_within_an_episode(synthetic_dataset: store.Dataset) -> None:
    rows = robot_fit.samples_from_dataset(synthetic_dataset)
    ends = np.flatnonzero(rows.following == 0)
    within = np.setdiff1d(np.arange(len(rows.following)), ends)
    # The next row starts where this one ends.
    np.testing.assert_array_equal(rows.state.lean[within + 1], rows.next_lean[within])
    assert rows.following[0] == ends[0] and np.any(rows.state.lean[ends[:-1] + 1] != rows.next_lean[ends[:-1]])


def test_episodes_shorter_than_the_horizon_are_refused(synthetic_dataset: store.Dataset) -> None:
    with pytest.raises(ShmooError, match="horizon"):
        robot_fit.train_robot(synthetic_dataset, None, replace(SMALL, horizon=100))


@pytest.mark.slow
def test_training_on_roll_outs_lessens_the_drift(synthetic_dataset: store.Dataset) -> None:
    known = robot_fit.train_robot(synthetic_dataset, None, SMALL).params
    astray = known._replace(output_mean=known.output_mean + 0.5 * known.output_scale)
    brief = replace(SMALL, epochs=3, epoch_updates=30, learning_rate=1e-3, horizon=10)
    rows = jax.tree.map(jnp.asarray, robot_fit.samples_from_dataset(synthetic_dataset))
    starts = np.flatnonzero(rows.following >= 10)

    def drift(rolled: float) -> float:
        tuned = robot_fit.train_robot(synthetic_dataset, None, replace(brief, rolled=rolled), start=astray)
        return float(robot_fit._rolled_out(brief, tuned.params, rows, starts))

    assert drift(1.0) < drift(0.0) < float(robot_fit._rolled_out(brief, astray, rows, starts))


def test_stops_when_validation_stops_improving() -> None:
    scores = iter([3.0, 2.0, 2.5, 2.4, 2.6, 0.1])
    fitted = training.run(
        0, lambda s: (s + 1, np.zeros(())), extract=lambda s: s, evaluate=lambda s: next(scores), epochs=6, patience=3
    )
    assert len(fitted.history) == 5 and fitted.score == 2.0 and int(fitted.best) == 2


def test_a_chunk_compiles_once() -> None:
    traces = []

    @jax.jit
    def epoch(state: jax.Array) -> tuple[jax.Array, jax.Array]:
        traces.append(1)
        return state + jnp.ones(3), jnp.sum(state)

    weak = jnp.broadcast_to(0.5, (3,))
    assert weak.weak_type
    training.run(weak, epoch, extract=lambda s: s, evaluate=lambda s: -s[0], epochs=3, patience=3)
    assert len(traces) == 1
