"""One constant-velocity Kalman filter per object and axis (x, y, yaw of {O} in the odometry frame {D}).

An object that is not detected is taken to come to rest. A detection far off what is expected is held back: if the next
ones agree with it, the object has really been displaced and the filter starts again there.
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
    """Numbers of the filter. Noise of the detections comes with them."""

    acceleration: float = 1.5
    """Standard deviation of an object's acceleration between frames [m/s^2]. More: follows faster, with noisier twists;
    from 1 to 2 the error of the twist in a push hardly changes."""
    yaw_acceleration: float = 2.0
    """Standard deviation of its yaw acceleration between frames [rad/s^2]. More: follows faster, with noisier yaw
    rates."""
    first_speed: float = 0.1
    """Standard deviation of an object's speed at first sight [m/s]: nearly all stand still."""
    first_yaw_rate: float = 0.2
    """Standard deviation of an object's yaw rate at first sight [rad/s]."""
    fading: float = 0.3
    """Time constant with which the twist of an object that is not detected fades [s]. Longer: carried on further."""
    gate: float = 25.0
    """Squared innovation over its variance, summed over the axes, above which a detection is held back: one in 65,000
    is by chance. More: believes false jumps sooner."""
    confirm: int = 3
    """Detections in a row, agreeing with each other, after which a jump is believed. More: later."""
    forget: float = 1.0
    """Time without a detection after which the filter starts anew with the next one [s]: a twist made up from where the
    object has meanwhile been put would be no twist."""
    fastest: float = 1.5
    """Speed up to which held-back detections can belong together [m/s]; in yaw, rad/s."""


class Tracks(NamedTuple):
    """W x N filters. Times are numbers of ticks."""

    pose: Float[Array, "W N 3"]
    """In {D}; NaN for an object that was never detected."""
    rate: Float[Array, "W N 3"]
    variance: Float[Array, "W N 3"]
    """Of the pose."""
    covariance: Float[Array, "W N 3"]
    """Of pose and rate."""
    rate_variance: Float[Array, "W N 3"]
    at: Float[Array, "W"]
    """Time that the filters stand at: that of the last frame."""
    detected_at: Float[Array, "W N"]
    """Time of the last frame in which the object was detected (and believed); -inf before."""
    arrived_at: Float[Array, "W N"]
    """When that frame arrived."""
    outlier: Float[Array, "W N 3"]
    """The last detection that was held back."""
    outlier_count: Float[Array, "W N"]
    """How many in a row were, each near the one before."""


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
    """Poses in {D} ``seconds`` after the filters' time."""
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
    """Take in one frame of each world; a world without one passes 0 seconds and nothing detected, and stays as it is.

    Args:
        config: of the filter.
        tracks: as they were.
        measured: detected poses in {D}.
        deviation: their standard deviations.
        detected: which objects were.
        seconds: since the frame before [s].
        time: numbers of the ticks at which the frame was taken and is taken in.
    """
    xp = se2.array_module(tracks.pose, measured, seconds)
    dt = seconds[:, None, None]
    pushed = dt**2 * np.array([config.acceleration, config.acceleration, config.yaw_acceleration]) ** 2
    # White acceleration, constant over a frame.
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
    # Whatever has been displaced may still be moving.
    fresh_rate = xp.where(rejected[..., None], (config.fastest / 3) ** 2, first) + 0.0 * rate_variance
    # It may have gone on instead: once a twist has faded, its whole square is uncertain.
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
