"""Eq. 7: supervised training of R on recorded samples, over a horizon if asked, and the fit of the lean's response."""

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
    batch: int = 512
    epochs: int = 80
    """Most epochs; the learning rate falls to zero over them along a cosine."""
    epoch_updates: int = 250
    learning_rate: float = 3e-3
    weight_decay: float = 1e-4
    input_noise: float = 0.02
    """Noise put on the inputs, in their standard deviations: a roll-out feeds R its own errors."""
    horizon: int = 0
    """Samples over which R is rolled out beside the one step of Eq. 7, the object moving as recorded; 0 for Eq. 7."""
    rolled: float = 0.1
    """Weight of the roll-outs' error against that of one step."""
    windows: int = 64
    """Roll-outs per update."""
    patience: int = 20
    """Epochs without a better validation score before stopping."""
    seed: int = 0


class RobotSamples(NamedTuple):
    """Samples of R, all conditions together; those of an episode follow one another."""

    inputs: Float[Array, "N 28"]
    labels: Float[Array, "N 5"]
    """Base acceleration and force, {R}."""
    state: SystemState
    """``[N, ...]`` at the start of the sample."""
    u: Float[Array, "N 3"]
    """Command [rad]."""
    next_lean: Float[Array, "N 2"]
    """At the end of the sample [rad]."""
    next_rate: Float[Array, "N 2"]
    """[rad/s]"""
    following: Int[Array, "N"]
    """How many samples of the same episode follow."""


class RobotFit(NamedTuple):
    """A trained R."""

    params: RobotParams
    score: float
    """Best validation score: share of each output's variance left unexplained, mean over the five."""
    per_output: Float[Array, "5"]
    """The same for each output, on the validation conditions."""
    history: list[tuple[float, float]]


class _State(NamedTuple):
    net: networks.Network
    opt: Any
    key: jax.Array


@single_precision
def samples_from_dataset(dataset: store.Dataset) -> RobotSamples:
    """The samples of every condition of a data set; the first sample of an episode has no past and is left out."""
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
    """Train R on a data set's train split, stopping on its validation split.

    Args:
        data: a directory that `store` wrote, or what `store.read` gave.
        out_dir: keeps a checkpoint there and goes on from it.
        config: settings.
        progress: called after each epoch.
        start: parameters to go on from, for fine-tuning on other data.

    Raises:
        ShmooError: no or a damaged data set, one without training or validation conditions, or a damaged checkpoint.
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
    """`train_robot` on samples that are already made.

    Raises:
        ShmooError: no episode is long enough for the horizon.
    """
    config = config or RobotFitConfig()
    params = _prepared(config, train) if start is None else start
    params = params._replace(lean=fit_lean(train))
    # The samples are arguments, not constants: XLA would fold constants of this size at length.
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
        identity=fingerprint(__name__, (config, start is None), train.inputs, train.labels),
        directory=out_dir,
        progress=progress,
    )
    net = jax.tree.map(jnp.asarray, fitted.best)
    return RobotFit(params._replace(net=net), fitted.score, np.asarray(scores(net)), fitted.history)


def fit_lean(samples: RobotSamples) -> LeanResponse:
    """The lean's response from each sample's start and end, by linear least squares per axis."""
    force = samples.state.last_force
    matrix = []
    for axis in range(2):
        columns = [samples.state.lean[:, axis], samples.state.lean_rate[:, axis], samples.u[:, axis], force[:, axis]]
        inputs = np.stack([*columns, np.ones(len(force))], axis=-1).astype(float)
        outputs = np.stack([samples.next_lean[:, axis], samples.next_rate[:, axis]], axis=-1).astype(float)
        # A trace of ridge: a recording without contact says nothing about the force.
        gram = inputs.T @ inputs + 1e-9 * len(inputs) * np.eye(5)
        matrix.append(np.linalg.solve(gram, inputs.T @ outputs).T)
    return LeanResponse(jnp.asarray(np.stack(matrix), jnp.float32))


def _prepared(config: RobotFitConfig, samples: RobotSamples) -> RobotParams:
    """Untrained parameters with the samples' normalisation."""
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
    """One epoch on samples, at some of which a roll-out may start."""
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
    """Mean squared error of twist and force over the horizon after the samples ``windows [B]``, in units of Eq. 7's."""
    # What psi says of the object is thrown away below, so any will do.
    shape = CoreConfig(robot=config.robot, object=ObjectConfig.paper())
    model = core.init(jax.random.key(0), shape)._replace(robot=params)

    def one(state: SystemState, sample: Any) -> tuple[SystemState, jax.Array]:
        now = jax.tree.map(lambda a: a[sample], samples.state)
        # The robot is where it was predicted to be, the object where it was.
        state = state._replace(object_pose=now.object_pose, object_twist=now.object_twist)
        new, _ = core.step(model, state, samples.u[sample], shape)
        then = jax.tree.map(lambda a: a[sample + 1], samples.state)
        drift = se2.rotate(new.robot_twist - then.robot_twist, -now.robot_pose[:, 2]) / DT
        return new, jnp.concatenate([drift, new.last_force - then.last_force], axis=-1)

    steps = jnp.arange(config.horizon)
    start = jax.tree.map(lambda a: a[windows], samples.state)
    error = jnp.asarray(jax.lax.scan(one, start, windows[None] + steps[:, None])[1] / params.output_scale)
    # After h steps of independent errors the twist's variance would be h times that of one.
    error = error.at[..., :3].divide(jnp.sqrt(1.0 + steps)[:, None, None])
    return jnp.mean(error**2)


def _unexplained(
    config: RobotFitConfig, params: RobotParams, rows: tuple[Array, Array], net: networks.Network
) -> Array:
    """Share of each output's variance left unexplained ``[5]`` on rows of inputs and labels."""
    inputs, labels = rows
    base, force = robot_model.predict(params._replace(net=net), inputs, config.robot)
    error = jnp.concatenate([base, force], axis=-1) - labels
    return jnp.mean(error**2, axis=0) / jnp.maximum(jnp.var(jnp.asarray(labels), axis=0), 1e-9)
