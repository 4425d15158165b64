"""Protocol of the compared methods: a method is fitted once, adapts on the first samples of a condition, and predicts.

A method takes training and validation conditions and returns a `Predictor`. For an unseen condition, ``adapt`` takes
the first samples, and ``predict`` returns the acceleration at other samples.
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
    """Recordings of C conditions as arrays."""

    samples: Samples
    time: Float[Array, "C N"]
    """Time since the start of the recording, without the gaps between episodes [s]."""
    pose: Float[Array, "C N 3"]
    """Pose of the object in {W} at the start of each sample [m, m, rad]."""


class Context(NamedTuple):
    """Samples of one condition that a method adapts on, in the order of the recording."""

    inputs: Float[Array, "N n"]
    labels: Float[Array, "N m"]
    weights: Float[Array, "N"]
    """Weight of each sample, 0 if it does not count."""
    time: Float[Array, "N"]
    """Time since the start of the recording [s]."""
    contact: Float[Array, "p"] | None = None
    """Contact parameters of the condition; None if the method has to estimate them (`sight`)."""


class Predictor(NamedTuple):
    """A fitted method. Both functions are pure and can be jitted."""

    adapt: Callable[[Context], State]
    predict: Callable[[State, Array, Array], Array]
    """(state, inputs ``[..., n]``, time ``[...]``) -> accelerations ``[..., m]``."""


@dataclass(frozen=True)
class Budget:
    """Training budget of a learned method, the same for all methods."""

    epochs: int = 20
    """Maximum number of epochs."""
    epoch_updates: int = 150
    """Updates per epoch."""
    patience: int = 8
    """Number of epochs without a better validation score before the training stops."""


@dataclass(frozen=True)
class Job:
    """One fit of one method."""

    train: Recordings
    validation: Recordings
    setting: Setting = field(default_factory=dict)
    budget: Budget = field(default_factory=Budget)
    seed: int = 0
    fit_samples: int = 250
    """Number of first samples of a validation condition that a method adapts on."""
    directory: Path | None = None
    """Directory of the training's checkpoint; None to keep none."""


Fit = Callable[[Job], Predictor]


@dataclass(frozen=True)
class Method:
    """A method of the comparison."""

    name: str
    fit: Fit
    settings: tuple[Setting, ...]
    """Settings to try on the validation conditions, the default first. All methods that learn have as many."""
    trained: bool = True
    """Whether the method is trained by gradient descent, so that the seed matters."""


def recordings(dataset: store.Dataset) -> Recordings:
    """Samples, times and poses of every condition of a data set."""
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
    """The first ``count`` samples of one condition, but at most half of its samples."""
    samples, n = recorded.samples, min(count, recorded.samples.inputs.shape[1] // 2)
    i = condition
    return Context(samples.inputs[i, :n], samples.labels[i, :n], samples.weights[i, :n], recorded.time[i, :n])


def output_scale(samples: Samples) -> Float[np.ndarray, "m"]:
    """Scale ``[m]`` of the methods' outputs: the standard deviation of each label over all samples that count."""
    return np.asarray(label_scale(samples), np.float32)
