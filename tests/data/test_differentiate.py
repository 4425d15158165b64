"""Acceleration labels."""

import numpy as np

from shmoo_mjx.data import differentiate
from shmoo_mjx.types import DT


def test_constant_acceleration_is_exact() -> None:
    time = DT * np.arange(8)
    twist = time[:, None] * np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(differentiate.sample_acceleration(twist), np.tile([1.0, -2.0, 0.5], (7, 1)))


def test_body_acceleration_turns_by_the_yaw_at_the_samples_start() -> None:
    pose = np.zeros((3, 3))
    pose[:, 2] = [np.pi / 2, 0.0, 0.0]
    twist = np.array([[0.0, 0, 0], [1.0, 0, 0.2], [1.0, 1.0, 0.2]])
    found = differentiate.body_acceleration(pose, twist)
    np.testing.assert_allclose(found, [[0.0, -10.0, 2.0], [0.0, 10.0, 0.0]], atol=1e-9)


def test_second_order_at_the_middle_of_the_sample() -> None:
    """Halving dt quarters the error against the acceleration at mid-sample."""
    errors = []
    for dt in (0.1, 0.05):
        time = np.arange(0, 1, dt)
        found = differentiate.sample_acceleration(np.sin(time)[:, None] * np.ones(3), dt)
        errors.append(np.max(np.abs(found[:, 0] - np.cos(time[:-1] + dt / 2))))
    assert errors[1] < errors[0] / 3.5
