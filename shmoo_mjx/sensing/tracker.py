"""One constant-velocity Kalman filter per object and axis (x, y, yaw of {O} in the odometry frame {D}).

While an object is not detected, its estimated twist decays to zero. A detection far from the prediction is held back as
an outlier. If the following detections agree with it, the object has been displaced, and the filter restarts there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Shaped
from shmoo_mjx.geometry import se2
from shmoo_mjx.sensing.odometry import TICK


@dataclass(frozen=True)
class TrackerConfig:
    """Settings of the filter. The measurement noise is an argument of :func:`update`."""

    acceleration: float = 1.5
    """Standard deviation of an object's acceleration between frames [m/s^2]. Larger values follow faster, with noisier
    twists. Between 1 and 2 the twist error during a push hardly changes."""
    yaw_acceleration: float = 2.0
    """Standard deviation of an object's yaw acceleration between frames [rad/s^2]. Larger values follow faster, with
    noisier yaw rates."""
    first_speed: float = 0.1
    """Standard deviation of an object's speed at its first detection [m/s]; small, since most objects stand still."""
    first_yaw_rate: float = 0.2
    """Standard deviation of an object's yaw rate at its first detection [rad/s]."""
    fading: float = 0.3
    """Time constant with which the twist of an undetected object decays [s]. Larger values extrapolate further."""
    gate: float = 25.0
    """Normalised squared innovation, summed over the axes, above which a detection is held back. Noise alone exceeds
    the default in one of 65,000 detections. Larger values accept more outliers."""
    confirm: int = 3
    """Number of consecutive, mutually consistent outliers that restart the filter. Larger values react later."""
    forget: float = 1.0
    """Time without a detection after which the next detection restarts the filter [s]. Someone may have moved the
    object meanwhile, and this displacement must not be taken for a twist."""
    fastest: float = 1.5
    """Speed up to which consecutive outliers count as consistent [m/s]; for yaw [rad/s]."""


class Tracks(NamedTuple):
    """State of W x N filters, three axes each. Times are in ticks."""

    pose: Float[Array, "W N 3"]
    """Estimated pose in {D} [m, rad]; NaN for an object that was never detected."""
    rate: Float[Array, "W N 3"]
    """Estimated twist in {D} [m/s, rad/s]."""
    variance: Float[Array, "W N 3"]
    """Variance of the pose."""
    covariance: Float[Array, "W N 3"]
    """Covariance of pose and rate."""
    rate_variance: Float[Array, "W N 3"]
    """Variance of the rate."""
    at: Float[Array, "W"]
    """Time of the estimates: that of the last frame."""
    detected_at: Float[Array, "W N"]
    """Time of the last frame with an accepted detection of the object; -inf if there was none."""
    arrived_at: Float[Array, "W N"]
    """Time at which that frame arrived; -inf if there was none."""
    outlier: Float[Array, "W N 3"]
    """Pose of the last detection that was held back, in {D}."""
    outlier_count: Float[Array, "W N"]
    """Number of consecutive outliers, each consistent with the one before."""


def init(worlds: int, objects: int) -> Tracks:
    """State before the first frame."""
    zero, flat = np.zeros((worlds, objects, 3)), np.zeros((worlds, objects))
    never = np.full((worlds, objects), -np.inf)
    return Tracks(zero + np.nan, zero, zero, zero, zero, np.zeros(worlds), never, never, zero, flat)


def ever_detected(tracks: Tracks) -> Bool[Array, "W N"]:
    """Whether each object has ever been detected."""
    xp = se2.array_module(tracks.pose)
    return xp.isfinite(tracks.pose[..., 0])


def ahead(tracks: Tracks, seconds: Float[Array, "W"]) -> Float[Array, "W N 3"]:
    """Poses in {D}, extrapolated by ``seconds`` from the filters' time."""
    return tracks.pose + tracks.rate * seconds[:, None, None]


def update(
    config: TrackerConfig,
    tracks: Tracks,
    measured: Float[Array, "W N 3"],
    deviation: Float[Array, "W N 3"],
    *,
    detected: Bool[Array, "W N"],
    seconds: Float[Array, "W"],
    time: tuple[Shaped[Array, "W"], Shaped[Array, "W"]],
) -> Tracks:
    """Update the filters with one frame per world.

    A world without a frame passes 0 seconds and no detection; its tracks do not change.

    Args:
        config: settings of the filter.
        tracks: state before the frame.
        measured: detected poses in {D} [m, rad].
        deviation: standard deviations of the detected poses [m, rad].
        detected: which objects were detected.
        seconds: time since the previous frame [s].
        time: ticks at which the frame was taken and at which it arrived.
    """
    xp = se2.array_module(tracks.pose, measured, seconds)
    dt = seconds[:, None, None]
    pushed = dt**2 * np.array([config.acceleration, config.acceleration, config.yaw_acceleration]) ** 2
    # Process noise: a random acceleration that is constant between two frames.
    variance = tracks.variance + 2 * dt * tracks.covariance + dt**2 * tracks.rate_variance + pushed * dt**2 / 4
    covariance = tracks.covariance + dt * tracks.rate_variance + pushed * dt / 2
    rate_variance = tracks.rate_variance + pushed
    pose = tracks.pose + dt * tracks.rate

    noise = deviation**2
    innovation = _difference(measured, pose)
    spread = variance + noise
    distance = xp.sum(innovation**2 / xp.maximum(spread, 1e-12), axis=-1)
    expected = detected & (distance <= config.gate)
    rejected = detected & ~expected & ever_detected(tracks)
    near = xp.sum(
        _difference(measured, tracks.outlier) ** 2 / (2 * noise + (config.fastest * dt) ** 2 + 1e-12), axis=-1
    )
    outlier_count = xp.where(
        rejected, xp.where(near <= 9.0, tracks.outlier_count + 1, 1.0), xp.where(expected, 0.0, tracks.outlier_count)
    )
    long_ago = time[0][:, None] - tracks.detected_at > config.forget / TICK
    restart = (detected & (~ever_detected(tracks) | long_ago)) | (rejected & (outlier_count >= config.confirm))

    gain, rate_gain = variance / xp.maximum(spread, 1e-12), covariance / xp.maximum(spread, 1e-12)
    fading = xp.exp(-dt / config.fading)
    first = np.array([config.first_speed, config.first_speed, config.first_yaw_rate]) ** 2
    # A displaced object may still be moving, so its initial rate is more uncertain.
    fresh_rate = xp.where(rejected[..., None], (config.fastest / 3) ** 2, first) + 0.0 * rate_variance
    # The object may have kept moving while the twist decayed, so the lost part adds to the variance.
    forgotten = rate_variance + tracks.rate**2 * (1 - fading**2)

    def choose(carried: Array, corrected: Array, fresh: Array) -> Array:
        return xp.where(restart[..., None], fresh, xp.where(expected[..., None], corrected, carried))

    pose = choose(pose, pose + gain * innovation, measured)
    believed = expected | restart
    taken, arrived = (xp.broadcast_to(t[:, None], believed.shape) for t in time)
    return Tracks(
        pose=xp.concatenate([pose[..., :2], se2.wrap(pose[..., 2:])], axis=-1),
        rate=choose(tracks.rate * fading, tracks.rate + rate_gain * innovation, 0.0 * tracks.rate),
        variance=choose(variance, (1 - gain) * variance, noise),
        covariance=choose(covariance, (1 - gain) * covariance, 0.0 * covariance),
        rate_variance=choose(forgotten, rate_variance - rate_gain * covariance, fresh_rate),
        at=tracks.at + seconds / TICK,
        detected_at=xp.where(believed, taken, tracks.detected_at),
        arrived_at=xp.where(believed, arrived, tracks.arrived_at),
        outlier=xp.where(rejected[..., None], measured, tracks.outlier),
        outlier_count=xp.where(restart, 0.0, outlier_count),
    )


def _difference(a: Array, b: Array) -> Array:
    xp = se2.array_module(a, b)
    return xp.concatenate([a[..., :2] - b[..., :2], se2.wrap(a[..., 2:] - b[..., 2:])], axis=-1)
