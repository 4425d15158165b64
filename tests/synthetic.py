"""Small planar objects under random wrenches, written as a data set the learners can read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from shmoo_mjx.data import store
from shmoo_mjx.geometry import se2
from shmoo_mjx.types import DT


def _condition(rng: np.random.Generator, episodes: int, samples: int) -> dict[str, np.ndarray]:
    """A rigid body with mass, anisotropic drag and a dead beat lean: enough for the learners to learn.

    In {O}: acceleration = (wrench - drag * twist) / inertia, exactly over each sample; the robot's base follows its
    lean, the force is a spring on the lean.
    """
    inertia = np.array([1.0, 1.0, 0.15]) * rng.uniform(3.0, 20.0)
    drag = np.array([rng.uniform(2, 10), rng.uniform(2, 60), rng.uniform(0.3, 2.0)])
    shape = (episodes, samples)
    arrays = {k: np.zeros((*shape, *tail), np.float32) for k, tail in store.FIELDS.items()}
    arrays["face"] = np.tile(np.array([-0.3, 0.0, 0.0, 0.3], np.float32), (episodes, 1))
    arrays["size"] = np.full(episodes, 0.42, np.float32)
    pose, twist = np.zeros((episodes, 3)), np.zeros((episodes, 3))
    robot, velocity = np.tile([-0.84, 0.0, 0.0], (episodes, 1)), np.zeros((episodes, 3))
    lean, rate = np.zeros((episodes, 2)), np.zeros((episodes, 2))
    u = np.zeros((episodes, 3))
    for k in range(samples):
        if k % 8 == 0:
            u = rng.normal(0, 0.08, (episodes, 3))
        force = 300.0 * lean + rng.normal(0, 0.2, (episodes, 2))
        wrench = np.concatenate([se2.rotate(force, -pose[:, 2]), 20.0 * u[:, 2:]], axis=-1)
        values = {"robot_pose": robot, "robot_twist": velocity, "lean": lean, "lean_rate": rate, "object_pose": pose}
        values |= {"object_twist": twist, "u": u, "force_robot": force, "wrench_object": wrench, "contact": 1.0}
        for name, value in values.items():
            arrays[name][:, k] = value
        body = se2.rotate(twist, -pose[:, 2])
        acceleration = se2.rotate((wrench - drag * body) / inertia, pose[:, 2])
        base = np.concatenate([4.0 * lean - velocity[:, :2], -velocity[:, 2:]], axis=-1)
        pose, twist = pose + twist * DT, twist + acceleration * DT
        robot, velocity = robot + velocity * DT, velocity + base * DT
        lean, rate = _lag(lean, rate, u[:, :2])
    return arrays


_WITHIN = expm(np.array([[0.0, 1.0], [-(6.0**2), -2 * 0.7 * 6.0]]) * DT)
"""Distance from the target and rate after one sample, over those before it."""


def _lag(lean: np.ndarray, rate: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequency 6 rad/s, damping 0.7."""
    distance, rate = np.einsum("ij,j...->i...", _WITHIN, np.stack([lean - target, rate]))
    return target + distance, rate


@pytest.fixture(scope="session")
def synthetic_directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 training, 3 validation and 3 test conditions of 4 episodes with 100 samples."""
    directory = tmp_path_factory.mktemp("synthetic")
    opened = store.create_or_open(directory, {"kind": "synthetic"})
    rng = np.random.default_rng(0)
    for i in range(18):
        split = "train" if i < 12 else ("validation" if i < 15 else "test")
        condition = {"family": "synthetic", "seed": i, "split": split}
        store.write_condition(opened, f"synthetic-{i:02d}", _condition(rng, 4, 100), condition)
    return directory


@pytest.fixture(scope="session")
def synthetic_dataset(synthetic_directory: Path) -> store.Dataset:
    """The same, read."""
    return store.read(synthetic_directory)
