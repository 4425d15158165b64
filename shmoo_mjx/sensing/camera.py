"""Simulated camera on the torso: which tags on objects it detects, and with which noise.

An object carries a tag at each corner of its top. A tag lies flat enough to be read from all sides, and the camera
looks down on every object of ours, so that an object hides other objects' tags and never its own. Walls hide whatever
is behind them, however low they are simulated. An object is detected in a frame if one of its tags is seen: one
AprilTag gives a whole pose. Neither arms and hands nor the camera's field of view up and down are looked at, and
lean is taken to be compensated by the inertial unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Scalar
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.sensing.rays import hidden

_CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
_INSET = 0.9
"""Of the footprint's half extents: where a tag's centre is, which has to be seen."""


_FAR_AWAY = 1e6
"""Where walls without size stand that fill up an array [m]."""
_WAY = 1.0
"""How far a robot may move while its near walls stay the same [m]."""


@dataclass(frozen=True)
class Camera:
    """An RGB-D camera of the RealSense D435 class that reads AprilTags of some 10 cm; judged where no source stands."""

    field_of_view: float = float(np.deg2rad(69.0))
    """Width of the field of view [rad]: the D435's colour image. Wider: sees more beside the robot."""
    near: float = 0.3
    """Nearest distance on the floor at which a tag is found [m]: the D435's least depth. Larger: no detection while
    pushing."""
    far: float = 4.0
    """Farthest one [m]: a tag of 10 cm is then some 16 pixels wide. Larger: objects are known earlier."""
    rate: float = 30.0
    """Frames per second [Hz]. Higher: less noise once filtered, more computing."""
    delay: tuple[float, float] = (0.02, 0.04)
    """Range from which the age of a frame on arrival is drawn for each robot [s]: exposure, transfer, finding tags.
    Longer: poses of what moves are guessed further ahead."""
    position_noise: float = 0.005 / 1.5
    """Standard deviation of a detected position over distance [m/m]: 5 mm at 1.5 m. More: noisier poses and twists."""
    yaw_noise: float = float(np.deg2rad(0.5)) / 1.5
    """Standard deviation of a detected yaw over distance [rad/m]: 0.5 deg at 1.5 m. More: noisier yaws and yaw
    rates."""
    least_position_noise: float = 0.0015
    """Least standard deviation of a position [m]: calibration and printing leave that however near the tag is."""
    least_yaw_noise: float = float(np.deg2rad(0.15))
    """Least standard deviation of a yaw [rad], for the same reason."""
    drop_out: float = 0.05
    """Share of frames in which an object in sight is not found: blur and glare meet all its tags alike."""
    burst: float = 0.005
    """Chance per frame that an object stays lost for ``burst_time``. More: longer times without its pose."""
    burst_time: float = 0.4
    """Duration of such a loss [s]. More: longer times without its pose."""
    objects_hide: bool = True
    """Whether objects hide what is behind them."""

    def __post_init__(self) -> None:
        low, high = self.delay
        rules = {
            "field_of_view": (0 < self.field_of_view <= 2 * np.pi + 1e-9, "an angle above 0 and up to 360 deg"),
            "near": (0 <= self.near < np.inf, "a distance of 0 m or more"),
            "far": (self.near < self.far < np.inf, "a distance beyond 'near'"),
            "rate": (0 < self.rate <= 100, "above 0 and up to 100 Hz"),
            "delay": (0 <= low <= high <= 1, "two times from 0 to 1 s, the smaller one first"),
            "drop_out": (0 <= self.drop_out <= 1, "a share from 0 to 1"),
            "burst": (0 <= self.burst <= 1, "a chance from 0 to 1"),
        }
        never_negative = ("position_noise", "yaw_noise", "least_position_noise", "least_yaw_noise", "burst_time")
        rules |= {name: (0 <= getattr(self, name) < np.inf, "a number of 0 or more") for name in never_negative}
        for name, (possible, need) in rules.items():
            if not possible:
                raise ShmooError(f"Camera: {name} is {getattr(self, name)}; give {need}.")


class Scenery(NamedTuple):
    """Sizes and walls that lines of sight depend on. W worlds, N objects, K walls."""

    eye: Float[Array, "W 3"]
    """The camera in {R}: x, y, and height above the floor [m]."""
    half_extents: Float[Array, "W N 2"]
    """Of the objects' footprints [m]."""
    tops: Float[Array, "W N"]
    """The objects' heights [m]."""
    wall_pose: Float[Array, "W K 3"]
    """In {W}."""
    wall_half: Float[Array, "W K 2"]
    """[m]"""


def scenery_of(scenes: list[Scene]) -> Scenery:
    """The scenery of some worlds; where one has fewer walls than another, walls without size lie far away."""
    most = max(len(s.walls) for s in scenes)
    pose, half = np.full((len(scenes), most, 3), [_FAR_AWAY, _FAR_AWAY, 0.0]), np.zeros((len(scenes), most, 2))
    eyes = []
    for i, scene in enumerate(scenes):
        walls, model = scene.walls, scene.model
        pose[i, : len(walls), :2], half[i, : len(walls)] = walls[:, :2], walls[:, 2:]
        pose[i, : len(walls), 2] = scene.wall_yaw
        x, y, z = model.geom("robot/torso_camera").pos
        eyes.append((x, y, z + model.geom("robot/ball").size[0]))
    sizes = np.array([[c.size for c in s.conditions] for s in scenes], dtype=float).reshape(len(scenes), -1, 3)
    return Scenery(np.array(eyes), sizes[..., :2] / 2, sizes[..., 2], pose, half)


def near_walls(scenery: Scenery, camera: Camera, robot_pose: Float[np.ndarray, "W 3"]) -> Scenery:
    """The scenery with those walls alone that can hide something from robots about there, for a sample time.

    Their number is filled up to 0, 16, 64, 256, ..., with walls without size far away: what is compiled for one number
    serves others.
    """
    x, y = (scenery.wall_pose[..., i] - robot_pose[:, None, i] for i in range(2))
    reach = scenery.wall_half.sum(axis=-1) + camera.far + _WAY
    near = x * x + y * y < reach * reach
    most = int(near.sum(axis=1).max(initial=0))
    size = 0 if most == 0 else 4 ** max(2, int(np.ceil(np.log(most) / np.log(4) - 1e-9)))
    pose, half = np.full((len(near), size, 3), [_FAR_AWAY, _FAR_AWAY, 0.0]), np.zeros((len(near), size, 2))
    for i, which in enumerate(near):
        count = int(which.sum())
        pose[i, :count], half[i, :count] = scenery.wall_pose[i, which], scenery.wall_half[i, which]
    return scenery._replace(wall_pose=pose, wall_half=half)


def in_sight(
    camera: Camera, scenery: Scenery, robot_pose: Float[Array, "W 3"], object_pose: Float[Array, "W N 3"]
) -> Bool[Array, "W N"]:
    """Whether some tag of each object is in the field of view, in range and not hidden.

    Args:
        camera: its limits.
        scenery: sizes and walls.
        robot_pose: true, in {W}.
        object_pose: true, in {W}.
    """
    xp = se2.array_module(robot_pose, object_pose)
    worlds, count = object_pose.shape[:2]
    if not count:
        return xp.zeros((worlds, 0), dtype=bool)
    eye = xp.concatenate([se2.transform_point(robot_pose, scenery.eye[:, :2]), scenery.eye[:, 2:]], axis=-1)
    corners = se2.transform_point(
        object_pose[:, :, None], scenery.half_extents[:, :, None] * _INSET * np.array(_CORNERS)
    )
    height = xp.broadcast_to(scenery.tops[:, :, None, None], (*corners.shape[:-1], 1))
    tags = xp.concatenate([corners, height], axis=-1).reshape(worlds, -1, 3)
    offset = se2.rotate(tags[..., :2] - eye[:, None, :2], -robot_pose[:, None, 2])
    far = xp.sqrt(xp.sum(offset * offset, axis=-1))
    visible = (far >= camera.near) & (far <= camera.far)
    visible &= xp.abs(xp.arctan2(offset[..., 1], offset[..., 0])) <= camera.field_of_view / 2
    high = xp.full(scenery.wall_pose.shape[:2], xp.inf)
    visible &= ~hidden(eye, tags, scenery.wall_pose, scenery.wall_half, tops=high).any(axis=1)
    visible = visible.reshape(worlds, count, 4)
    if camera.objects_hide and count > 1:
        by = hidden(eye, tags, object_pose, scenery.half_extents, tops=scenery.tops).reshape(worlds, count, count, 4)
        visible &= ~(by & ~np.eye(count, dtype=bool)[None, :, :, None]).any(axis=1)
    return visible.any(axis=-1)


def deviation(camera: Camera, distance: Scalar | Float[Array, "..."]) -> Float[Array, "... 3"]:
    """Standard deviations of a detected pose (x, y [m], yaw [rad]) at ``distance`` [m]."""
    xp = se2.array_module(distance)
    position = xp.maximum(camera.position_noise * distance, camera.least_position_noise)
    yaw = xp.maximum(camera.yaw_noise * distance, camera.least_yaw_noise)
    return se2.stack(position, position, yaw)
