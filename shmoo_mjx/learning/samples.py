"""Recorded samples in the form for the training of psi, and the batches drawn from them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Int, Key, single_precision
from shmoo_mjx.data import store
from shmoo_mjx.dynamics import features
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2


class Samples(NamedTuple):
    """C conditions with N samples each, in the order of the recording."""

    inputs: Float[Array, "C N n_in"]
    """Inputs of psi."""
    labels: Float[Array, "C N m"]
    """Accelerations in {O}, or the labels of an external data set."""
    weights: Float[Array, "C N"]
    """1 if a sample counts; 0 for padding and for an object at rest without contact."""
    run: Int[Array, "C N"]
    """Number of remaining samples in the same episode, including this one."""


class Sampler(NamedTuple):
    """Indices from which batches are drawn."""

    samples: Int[Array, "C M"]
    """Indices of samples on which a* can be fitted."""
    starts: Int[Array, "C S"]
    """Indices of first samples of windows of H steps within one episode, in ascending order."""
    precision: Float[Array, "C m m"]
    """Inverse of Sigma_C in units of label_scale."""


class Batch(NamedTuple):
    """Samples of one update, for each of its conditions."""

    condition: Int[Array, "c"]
    """Indices of the training conditions."""
    adapt: tuple[Float[Array, "c N n_in"], Float[Array, "c N m"], Float[Array, "c N"]]
    """Inputs, labels and weights of B^a."""
    windows: tuple[Float[Array, "c B H n_in"], Float[Array, "c B H m"], Float[Array, "c B H n_in"]]
    """Inputs, labels, and the inputs one sample later, which hold the resulting twist."""
    precision: Float[Array, "c m m"]
    """Inverse of Sigma_C in units of label_scale."""


@single_precision
def samples_from_dataset(dataset: store.Dataset) -> Samples:
    """The samples of psi (OBJECT_INPUTS, acceleration in {O}) for all conditions of a data set."""
    inputs, labels, weights, runs = [], [], [], []
    for arrays in dataset.arrays:
        recorded = store.system_states(arrays)
        twist = se2.rotate(recorded.state.object_twist, -recorded.state.object_pose[..., 2])
        last = recorded.state
        x = features.object_inputs(
            twist, recorded.wrench, last_twist=last.last_object_twist, size=last.size, last_wrench=last.last_wrench
        )
        n_episodes, length = x.shape[:2]
        moving = np.linalg.norm(twist, axis=-1) > 5e-3
        counts = recorded.contact | moving
        counts[:, 0] = False  # the twist before an episode's first sample is not known
        run = np.broadcast_to(length - np.arange(length), (n_episodes, length))
        inputs.append(np.asarray(x).reshape(-1, x.shape[-1]))
        labels.append(recorded.object_acceleration.reshape(-1, 3))
        weights.append(counts.reshape(-1))
        runs.append(run.reshape(-1))
    return _stack(inputs, labels, weights, runs)


def samples_from_arrays(
    data: Mapping[str, tuple[Float[Array, "_N n_in"], Float[Array, "_N m"]]],
    widths: tuple[int | None, int | None] = (None, None),
) -> Samples:
    """Samples from arrays {condition: (x, y)}. The conditions can have different numbers of samples.

    Args:
        data: inputs and labels of each condition.
        widths: required n_in and m; those of the first condition if None.

    Raises:
        ShmooError: there is no condition, or `checked_pair` refuses one.
    """
    if not data:
        raise ShmooError("train or validation has no condition; give at least one of each, as {condition: (x, y)}.")
    pairs = []
    for condition, (x, y) in data.items():
        pairs.append(checked_pair(f"condition {condition!r}", x, y, widths))
        widths = pairs[-1][0].shape[1], pairs[-1][1].shape[1]
    return _stack(
        [x for x, _ in pairs],
        [y for _, y in pairs],
        [np.ones(len(x)) for x, _ in pairs],
        [len(x) - np.arange(len(x)) for x, _ in pairs],
    )


def checked_pair(
    name: str, x: Any, y: Any, widths: tuple[int | None, int | None]
) -> tuple[Float[np.ndarray, "N n_in"], Float[np.ndarray, "N m"]]:
    """Inputs and labels of the same samples, as `checked_rows` with ``widths``.

    Raises:
        ShmooError: x and y have different numbers of rows, or none, or `checked_rows` refuses one of them.
    """
    x, y = checked_rows(f"{name}: x", x, widths[0]), checked_rows(f"{name}: y", y, widths[1])
    if len(x) != len(y) or not len(x):
        raise ShmooError(f"{name}: x has {len(x)} rows and y {len(y)}; give as many of each, and at least one.")
    return x, y


def checked_rows(name: str, values: Any, width: int | None) -> Float[np.ndarray, "N n"]:
    """``values`` in single precision, with one row per sample and ``width`` columns, or any number if None.

    Raises:
        ShmooError: the shape is another, or not all values are finite numbers.
    """
    try:
        numbers = np.asarray(values, np.float32)
    except (TypeError, ValueError):
        raise ShmooError(f"{name}: is no array of numbers; give one row of numbers per sample.") from None
    if numbers.ndim != 2 or width not in (None, numbers.shape[1]):
        raise ShmooError(
            f"{name}: the array has shape {numbers.shape}; give [N, {width or 'n'}], with one row per sample and the "
            "same columns in all."
        )
    if not np.isfinite(numbers).all():
        raise ShmooError(f"{name}: not all numbers are finite; leave those rows out.")
    return numbers


def label_scale(samples: Samples) -> Float[np.ndarray, "m"]:
    """Standard deviation of each label over all samples that count."""
    used = samples.labels[samples.weights > 0]
    return np.maximum(np.std(used, axis=0), 1e-6)


def sampler(samples: Samples, horizon: int, floor: float) -> Sampler:
    """The indices from which `draw` makes batches with windows of ``horizon`` steps.

    ``floor``, in units of label_scale squared, is added to the diagonal of Sigma_C.
    """
    scale = label_scale(samples)
    usable, starts, precision = [], [], []
    for y, w, run in zip(samples.labels, samples.weights, samples.run, strict=True):
        good = np.flatnonzero(w > 0)
        begin = np.flatnonzero((w > 0) & (run >= horizon))
        usable.append(good if len(good) else np.zeros(1, int))
        starts.append(begin if len(begin) else np.zeros(1, int))
        scaled = y[good] / scale
        covariance = np.cov(scaled.T).reshape(y.shape[1], y.shape[1]) if len(good) > 1 else np.zeros((y.shape[1],) * 2)
        precision.append(np.linalg.inv(covariance + floor * np.eye(y.shape[1])))
    return Sampler(_repeat(usable), jnp.sort(_repeat(starts), axis=1), jnp.asarray(np.stack(precision), jnp.float32))


def draw(
    samples: Samples,
    sampler: Sampler,
    key: Key[Array, ""],
    *,
    conditions: int,
    adapt_samples: int,
    windows: int,
    horizon: int,
) -> Batch:
    """Draw a batch of conditions, each with a stretch B^a and windows.

    Args:
        samples: all training conditions.
        sampler: result of `sampler` for these samples.
        key: random key.
        conditions: number of conditions.
        adapt_samples: maximum length of B^a.
        windows: number of windows per condition.
        horizon: number of steps of a window.
    """
    condition_key, sample_key, length_key, start_key, near_key = jax.random.split(key, 5)
    n_conditions, n_samples = samples.inputs.shape[:2]
    count = min(conditions, n_conditions)
    c = jax.random.permutation(condition_key, n_conditions)[:count]
    begin = jax.random.randint(sample_key, (count,), 0, sampler.samples.shape[1])
    most = min(adapt_samples, sampler.samples.shape[1])
    # The length is log-uniform, from 5 samples (half a second) to the maximum.
    length = jnp.exp(jax.random.uniform(length_key, (count, 1), minval=jnp.log(5.0), maxval=jnp.log(most + 1.0)))
    place = (begin[:, None] + jnp.arange(most)) % sampler.samples.shape[1]
    sample = jnp.take_along_axis(sampler.samples[c], place, axis=1)
    adapt = (
        samples.inputs[c[:, None], sample],
        samples.labels[c[:, None], sample],
        (jnp.arange(most) < length).astype(jnp.float32),
    )
    starts = sampler.starts[c]
    anywhere = jax.random.randint(start_key, (count, windows), 0, starts.shape[1])
    last = jnp.take_along_axis(sample, jnp.minimum(length.astype(int), most - 1), axis=1)
    soon = jax.vmap(jnp.searchsorted)(starts, last) + jax.random.randint(near_key, (count, windows), 0, 50)
    near = jnp.arange(windows) < windows // 2
    start = jnp.take_along_axis(starts, jnp.where(near, soon % starts.shape[1], anywhere), axis=1)
    window = start[..., None] + jnp.arange(horizon)
    x, y = samples.inputs[c[:, None, None], window], samples.labels[c[:, None, None], window]
    return Batch(
        c, adapt, (x, y, samples.inputs[c[:, None, None], jnp.minimum(window + 1, n_samples - 1)]), sampler.precision[c]
    )


def _stack(inputs: list, labels: list, weights: list, runs: list) -> Samples:
    """Stack conditions of different lengths, padded at the end with samples of weight zero."""
    longest = max(len(x) for x in inputs)

    def pad(items: list, mode: Literal["constant", "edge"] = "constant") -> np.ndarray:
        whole = [np.pad(a, [(0, longest - len(a))] + [(0, 0)] * (np.ndim(a) - 1), mode=mode) for a in items]
        return np.stack(whole).astype(np.float32)

    # Pad inputs with the last sample: zeros would give an object of size 0, by which the contact model divides.
    return Samples(pad(inputs, "edge"), pad(labels), pad(weights), pad(runs).astype(np.int32))


def _repeat(items: list[np.ndarray]) -> Array:
    longest = max(len(i) for i in items)
    return jnp.asarray(np.stack([np.resize(i, longest) for i in items]), jnp.int32)
