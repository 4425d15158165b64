"""What every method of the comparison is: it is fitted once, adapts on the first samples of a condition, and predicts.

A method gets training and validation conditions and answers with a `Predictor`. A predictor meets a condition that
it has not seen: ``adapt`` takes the condition's first samples, ``predict`` tells the acceleration at others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.data import store
from shmoo_mjx.learning.samples import Samples, label_scale, samples_from_dataset
from shmoo_mjx.types import DT

State = Any
Setting = dict[str, Any]


class Recordings(NamedTuple):
    """C conditions as arrays."""

    samples: Samples
    time: Float[Array, "C N"]
    """Since the recording began, gaps between episodes left out [s]."""
    pose: Float[Array, "C N 3"]
    """Of the object in {W} at the start of each sample."""


class Context(NamedTuple):
    """What a method adapts on: some samples of one condition in the order they were recorded."""

    inputs: Float[Array, "N n"]
    labels: Float[Array, "N m"]
    weights: Float[Array, "N"]
    """0 where a sample does not count."""
    time: Float[Array, "N"]
    """[s]"""
    contact: Float[Array, "p"] | None = None
    """Contact parameters of the condition, where they are known already (`sight`)."""


class Predictor(NamedTuple):
    """A fitted method. Both functions can be jitted; neither keeps anything between calls."""

    adapt: Callable[[Context], State]
    predict: Callable[[State, Array, Array], Array]
    """(state, inputs ``[..., n]``, time ``[...]``) -> accelerations ``[..., m]``."""


@dataclass(frozen=True)
class Budget:
    """How long a learned method may train: the same for each."""

    epochs: int = 20
    """Most epochs."""
    epoch_updates: int = 150
    """Updates per epoch."""
    patience: int = 8
    """Chunks without a better validation score before stopping."""


@dataclass(frozen=True)
class Job:
    """One fit of one method."""

    train: Recordings
    validation: Recordings
    setting: Setting = field(default_factory=dict)
    budget: Budget = field(default_factory=Budget)
    seed: int = 0
    fit_samples: int = 250
    """Samples at the start of a validation condition that a method adapts on."""
    directory: Path | None = None
    """Keeps the training's checkpoint, finished or not."""


Fit = Callable[[Job], Predictor]


@dataclass(frozen=True)
class Method:
    """A sample of the comparison."""

    name: str
    fit: Fit
    settings: tuple[Setting, ...]
    """What is tried on the validation conditions, the default first. Every method that learns has as many."""
    trained: bool = True
    """By gradient descent, so that the seed matters."""


def recordings(dataset: store.Dataset) -> Recordings:
    """The samples of every condition with what the comparison needs beside them."""
    samples = samples_from_dataset(dataset)
    n = samples.inputs.shape[1]
    poses, times = [], []
    for arrays in dataset.arrays:
        pose = arrays["object_pose"]
        count = pose.shape[0] * (pose.shape[1] - 1)
        assert count <= n, "samples and poses are of different recordings"
        time = DT * np.arange(pose.shape[0] * pose.shape[1]).reshape(pose.shape[:2])[:, :-1].reshape(-1)
        poses.append(np.pad(pose[:, :-1].reshape(-1, 3), ((0, n - count), (0, 0))))
        times.append(np.pad(time, (0, n - count), mode="edge"))
    return Recordings(samples, np.stack(times).astype(np.float32), np.stack(poses).astype(np.float32))


def first_samples(recorded: Recordings, condition: int, count: int) -> Context:
    """The first ``count`` samples of one condition, at most half of them."""
    samples, n = recorded.samples, min(count, recorded.samples.inputs.shape[1] // 2)
    i = condition
    return Context(samples.inputs[i, :n], samples.labels[i, :n], samples.weights[i, :n], recorded.time[i, :n])


def output_scale(samples: Samples) -> Float[np.ndarray, "m"]:
    """The unit in which methods predict."""
    return np.asarray(label_scale(samples), np.float32)
