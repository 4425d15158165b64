"""Eq. 7: supervised training of R on recorded samples, optionally over a horizon, and the fit of the lean response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from shmoo_mjx.arrays import Array, Float, Int, single_precision
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.data import store
from shmoo_mjx.dynamics import core, features, networks, robot_model
from shmoo_mjx.dynamics.core import CoreConfig
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.dynamics.robot_model import LeanResponse, RobotConfig, RobotParams
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning import training
from shmoo_mjx.types import DT, SystemState


@dataclass(frozen=True)
class RobotFitConfig:
    """Settings of the training of R."""

    robot: RobotConfig = field(default_factory=lambda: RobotConfig())
    """Structure of R."""
    batch: int = 512
    """Number of samples per update."""
    epochs: int = 80
    """Maximum number of epochs. The learning rate falls to zero over them along a cosine."""
    epoch_updates: int = 250
    """Number of updates per epoch."""
    learning_rate: float = 3e-3
    """Initial learning rate of AdamW."""
    weight_decay: float = 1e-4
    """Weight decay of AdamW."""
    input_noise: float = 0.02
    """Standard deviation of the noise added to the inputs, in standard deviations of each input [1]. It prepares R for
    its own errors in roll-outs; larger regularises R more."""
    horizon: int = 0
    """Length of the roll-outs of R that are trained in addition to the one step of Eq. 7 [samples]. The object moves as
    recorded. 0 gives Eq. 7."""
    rolled: float = 0.1
    """Weight of the roll-out error relative to the one-step error."""
    windows: int = 64
    """Number of roll-outs per update."""
    patience: int = 20
    """Number of epochs without a better validation score before the training stops."""
    seed: int = 0
    """Seed of the initial weights and of the batches."""


class RobotSamples(NamedTuple):
    """Training samples of R from all conditions. The samples of an episode are consecutive."""

    inputs: Float[Array, "N 28"]
    """Inputs of R in the order of ROBOT_INPUTS."""
    labels: Float[Array, "N 5"]
    """Base acceleration and hand force in {R}, in the order of ROBOT_OUTPUTS."""
    state: SystemState
    """State ``[N, ...]`` at the start of the sample."""
    u: Float[Array, "N 3"]
    """Command (phi_x, phi_y, gamma) [rad]."""
    next_lean: Float[Array, "N 2"]
    """Lean at the end of the sample [rad]."""
    next_rate: Float[Array, "N 2"]
    """Rate of the lean at the end of the sample [rad/s]."""
    following: Int[Array, "N"]
    """Number of samples of the same episode that follow."""


class RobotFit(NamedTuple):
    """A trained R."""

    params: RobotParams
    """Parameters of R and of the lean response."""
    score: float
    """Best validation score: fraction of variance unexplained, mean over the five outputs. Lower is better."""
    per_output: Float[Array, "5"]
    """Fraction of variance unexplained of each output on the validation conditions."""
    history: list[tuple[float, float]]
    """(training loss, validation score) of each epoch."""


class _State(NamedTuple):
    """State of the training between updates."""

    net: networks.Network
    opt: Any
    key: jax.Array


@single_precision
def samples_from_dataset(dataset: store.Dataset) -> RobotSamples:
    """The samples of all conditions of a data set, without the first sample of each episode, which has no past."""
    rows = [_condition_rows(arrays) for arrays in dataset.arrays]
    return jax.tree.map(lambda *parts: np.concatenate(parts), *rows)


def _condition_rows(arrays: dict[str, np.ndarray]) -> RobotSamples:
    recorded = store.system_states(arrays)
    episodes, n = recorded.u.shape[:2]
    samples = RobotSamples(
        np.asarray(features.robot_inputs(recorded.state, recorded.u)),
        np.concatenate([recorded.robot_acceleration, recorded.force], axis=-1),
        recorded.state,
        recorded.u,
        arrays["lean"][:, 1:],
        arrays["lean_rate"][:, 1:],
        np.repeat(np.arange(n)[None, ::-1, None], episodes, axis=0),
    )
    samples = jax.tree.map(lambda a: a[:, 1:].reshape(-1, *a.shape[2:]).astype(np.float32), samples)
    return samples._replace(following=samples.following[:, 0].astype(np.int32))


@single_precision
def train_robot(
    data: str | Path | store.Dataset,
    out_dir: str | Path | None = None,
    config: RobotFitConfig | None = None,
    *,
    progress: Callable[[training.Progress], None] | None = None,
    start: RobotParams | None = None,
) -> RobotFit:
    """Train R on the train split of a data set, with early stopping on its validation split.

    Args:
        data: a directory written by `store`, or a result of `store.read`.
        out_dir: directory of the checkpoint. An interrupted training resumes from it.
        config: settings.
        progress: called after each epoch.
        start: initial parameters, for fine-tuning on other data; untrained if None.

    Raises:
        ShmooError: the data set is missing or damaged or has no training or validation conditions, or the checkpoint
            is damaged.
    """
    dataset = store.of_training(data)
    train, validation = dataset.split("train"), dataset.split("validation")
    return fit_samples(
        samples_from_dataset(train),
        samples_from_dataset(validation),
        config,
        out_dir=out_dir,
        progress=progress,
        start=start,
    )


@single_precision
def fit_samples(
    train: RobotSamples,
    validation: RobotSamples,
    config: RobotFitConfig | None = None,
    *,
    out_dir: str | Path | None = None,
    progress: Callable[[training.Progress], None] | None = None,
    start: RobotParams | None = None,
) -> RobotFit:
    """`train_robot` on prepared samples.

    Args:
        train: training samples.
        validation: validation samples.
        config: settings.
        out_dir: directory of the checkpoint. An interrupted training resumes from it.
        progress: called after each epoch.
        start: initial parameters; untrained if None.

    Raises:
        ShmooError: every episode is shorter than the horizon.
    """
    config = config or RobotFitConfig()
    params = _prepared(config, train) if start is None else start
    params = params._replace(lean=fit_lean(train))
    # Pass the samples as arguments because XLA takes long to fold constants of this size.
    scores_of = jax.jit(partial(_unexplained, config))
    scores = partial(scores_of, params, (jnp.asarray(validation.inputs), jnp.asarray(validation.labels)))
    epoch = jax.jit(partial(_epoch, config))
    samples = jax.tree.map(jnp.asarray, train)
    starts = np.flatnonzero(train.following >= config.horizon)
    if not starts.size:
        raise ShmooError(
            f"training data of R: field 'horizon' is {config.horizon} samples, and every episode is shorter; record "
            "longer episodes or lower it."
        )
    optimiser = _optimiser(config)
    key = jax.random.key_data(jax.random.key(config.seed))
    fitted = training.run(
        _State(params.net, optimiser.init(params.net.layers), key),
        lambda state: epoch(params, (samples, starts), state),
        extract=lambda state: state.net,
        evaluate=lambda net: jnp.mean(scores(net)),
        epochs=config.epochs,
        patience=config.patience,
        identity=fingerprint(__name__, config, *_deciding(train, validation, start)),
        directory=out_dir,
        progress=progress,
    )
    net = jax.tree.map(jnp.asarray, fitted.best)
    return RobotFit(params._replace(net=net), fitted.score, np.asarray(scores(net)), fitted.history)


def _deciding(train: RobotSamples, validation: RobotSamples, start: RobotParams | None) -> list[Array]:
    """Arrays that, beside the config, determine the training."""
    return [*(part for data in (train, validation) for part in (data.inputs, data.labels)), *jax.tree.leaves(start)]


def fit_lean(samples: RobotSamples) -> LeanResponse:
    """The lean response, fitted to the start and end of each sample by linear least squares per axis."""
    force = samples.state.last_force
    matrix = []
    for axis in range(2):
        columns = [samples.state.lean[:, axis], samples.state.lean_rate[:, axis], samples.u[:, axis], force[:, axis]]
        inputs = np.stack([*columns, np.ones(len(force))], axis=-1).astype(float)
        outputs = np.stack([samples.next_lean[:, axis], samples.next_rate[:, axis]], axis=-1).astype(float)
        # The small ridge makes the problem solvable for recordings without contact, where the force is always zero.
        gram = inputs.T @ inputs + 1e-9 * len(inputs) * np.eye(5)
        matrix.append(np.linalg.solve(gram, inputs.T @ outputs).T)
    return LeanResponse(jnp.asarray(np.stack(matrix), jnp.float32))


def _prepared(config: RobotFitConfig, samples: RobotSamples) -> RobotParams:
    """Untrained parameters, normalised with the statistics of the samples."""
    params = robot_model.init(jax.random.key(config.seed + 1), config.robot)
    return params._replace(
        net=networks.with_normaliser(params.net, jnp.asarray(samples.inputs), robot_model.REFLECTIONS[0]),
        output_mean=networks.parts(robot_model.REFLECTIONS[1])[0] @ jnp.mean(jnp.asarray(samples.labels), axis=0),
        output_scale=jnp.maximum(jnp.std(jnp.asarray(samples.labels), axis=0), 1e-3),
    )


def _optimiser(config: RobotFitConfig) -> optax.GradientTransformation:
    schedule = optax.cosine_decay_schedule(config.learning_rate, config.epochs * config.epoch_updates)
    return optax.chain(training.bounded_gradient(), optax.adamw(schedule, weight_decay=config.weight_decay))


def _epoch(
    config: RobotFitConfig, params: RobotParams, data: tuple[RobotSamples, Array], state: _State
) -> tuple[_State, Array]:
    """One epoch of updates. ``data`` holds the samples and the indices at which a roll-out can start."""
    samples, starts = data
    optimiser = _optimiser(config)

    def update(state: _State, _: None) -> tuple[_State, Array]:
        key, sample_key, noise_key, window_key = jax.random.split(jax.random.wrap_key_data(state.key), 4)
        chosen = jax.random.randint(sample_key, (config.batch,), 0, samples.inputs.shape[0])
        x, y = samples.inputs[chosen], (samples.labels[chosen] - params.output_mean) / params.output_scale
        x = x + config.input_noise * state.net.scale * jax.random.normal(noise_key, x.shape)
        picked = jax.random.randint(window_key, (config.windows,), 0, starts.shape[0])

        def loss_of(layers: Any) -> Array:
            net = state.net._replace(layers=layers)
            loss = jnp.mean((robot_model.normalised(net, x, config.robot) - y) ** 2)
            if config.horizon > 0:
                model = params._replace(net=net)
                loss = loss + config.rolled * _rolled_out(config, model, samples, starts[picked])
            return loss

        loss, gradient = jax.value_and_grad(loss_of)(state.net.layers)
        change, opt = optimiser.update(gradient, state.opt, state.net.layers)
        net = state.net._replace(layers=optax.apply_updates(state.net.layers, change))
        return _State(net, opt, jax.random.key_data(key)), loss

    state, losses = jax.lax.scan(update, state, None, length=config.epoch_updates)
    return state, jnp.mean(losses)


def _rolled_out(config: RobotFitConfig, params: RobotParams, samples: RobotSamples, windows: Array) -> Array:
    """Mean squared error of twist and force over roll-outs that start at the samples ``windows [B]``.

    The error has the same scale as the one-step error of Eq. 7.
    """
    # The predicted motion of the object is discarded below, so an untrained psi is enough.
    shape = CoreConfig(robot=config.robot, object=ObjectConfig.paper())
    model = core.init(jax.random.key(0), shape)._replace(robot=params)

    def one(state: SystemState, sample: Any) -> tuple[SystemState, jax.Array]:
        now = jax.tree.map(lambda a: a[sample], samples.state)
        # Feed back the predicted state of the robot, but use the recorded state of the object.
        state = state._replace(object_pose=now.object_pose, object_twist=now.object_twist)
        new, _ = core.step(model, state, samples.u[sample], shape)
        then = jax.tree.map(lambda a: a[sample + 1], samples.state)
        drift = se2.rotate(new.robot_twist - then.robot_twist, -now.robot_pose[:, 2]) / DT
        return new, jnp.concatenate([drift, new.last_force - then.last_force], axis=-1)

    steps = jnp.arange(config.horizon)
    start = jax.tree.map(lambda a: a[windows], samples.state)
    error = jnp.asarray(jax.lax.scan(one, start, windows[None] + steps[:, None])[1] / params.output_scale)
    # With independent errors, the variance of the twist after h steps is h times that of one step.
    error = error.at[..., :3].divide(jnp.sqrt(1.0 + steps)[:, None, None])
    return jnp.mean(error**2)


def _unexplained(
    config: RobotFitConfig, params: RobotParams, rows: tuple[Array, Array], net: networks.Network
) -> Array:
    """Fraction of variance unexplained of each output ``[5]``. ``rows`` holds inputs and labels."""
    inputs, labels = rows
    base, force = robot_model.predict(params._replace(net=net), inputs, config.robot)
    error = jnp.concatenate([base, force], axis=-1) - labels
    return jnp.mean(error**2, axis=0) / jnp.maximum(jnp.var(jnp.asarray(labels), axis=0), 1e-9)
