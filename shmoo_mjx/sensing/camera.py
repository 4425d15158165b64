"""Simulated torso camera: which objects it detects by their tags, and with which noise.

Every object has a tag at each corner of its top. The tags lie flat and can be read from all sides. An object is
detected in a frame if at least one of its tags is visible, because one AprilTag gives the full pose.

Occlusion: the camera is higher than every shipped object, so an object occludes the tags of other objects but never its
own. Walls occlude everything behind them, independent of their simulated height. The model ignores occlusion by arms
and hands and the vertical field of view. It assumes that the inertial unit compensates lean.
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
"""Position of a tag's centre as a fraction of the footprint's half extents. The centre must be visible."""


_FAR_AWAY = 1e6
"""Coordinate of the zero-size walls that pad an array [m]."""
_WAY = 1.0
"""Largest motion of the robot during which the selection of near walls stays valid [m]."""


@dataclass(frozen=True)
class Camera:
    """RGB-D camera of the RealSense D435 class that reads AprilTags of about 10 cm.

    Values without a stated source are estimates.
    """

    field_of_view: float = float(np.deg2rad(69.0))
    """Horizontal field of view [rad]; the default is that of the D435's colour image. Larger values see more beside the
    robot."""
    near: float = 0.3
    """Smallest horizontal distance at which a tag is detected [m]; the default is the D435's minimum depth. Larger
    values prevent detections while pushing."""
    far: float = 4.0
    """Largest horizontal distance at which a tag is detected [m]; a tag of 10 cm is about 16 pixels wide at 4 m. Larger
    values detect objects earlier."""
    rate: float = 30.0
    """Frame rate [Hz]. Larger values reduce the filtered noise and need more computing time."""
    delay: tuple[float, float] = (0.02, 0.04)
    """Range of a frame's age on arrival [s], drawn per robot: exposure, transfer and tag detection. With a longer
    delay, poses of moving objects are extrapolated further."""
    position_noise: float = 0.005 / 1.5
    """Standard deviation of a detected position per distance [m/m]; the default gives 5 mm at 1.5 m. Larger values make
    poses and twists noisier."""
    yaw_noise: float = float(np.deg2rad(0.5)) / 1.5
    """Standard deviation of a detected yaw per distance [rad/m]; the default gives 0.5 deg at 1.5 m. Larger values make
    yaws and yaw rates noisier."""
    least_position_noise: float = 0.0015
    """Smallest standard deviation of a detected position [m], due to calibration and printing errors. It applies at
    short distances."""
    least_yaw_noise: float = float(np.deg2rad(0.15))
    """Smallest standard deviation of a detected yaw [rad], for the same reason."""
    drop_out: float = 0.05
    """Fraction of frames in which a visible object is missed. Blur and glare affect all tags of an object together."""
    burst: float = 0.005
    """Probability per frame that an object is lost for ``burst_time``. Larger values lose objects more often."""
    burst_time: float = 0.4
    """Duration of such a loss [s]. Larger values lose objects for longer."""
    objects_hide: bool = True
    """Whether objects occlude other objects."""

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
    """Geometry that determines lines of sight, for W worlds, N objects and K walls."""

    eye: Float[Array, "W 3"]
    """Position of the camera: x and y in {R}, and height above the floor [m]."""
    half_extents: Float[Array, "W N 2"]
    """Half extents of the objects' footprints [m]."""
    tops: Float[Array, "W N"]
    """Heights of the objects [m]."""
    wall_pose: Float[Array, "W K 3"]
    """Poses (x, y, yaw) of the walls in {W} [m, rad]."""
    wall_half: Float[Array, "W K 2"]
    """Half extents of the walls along their own axes [m]."""


def scenery_of(scenes: list[Scene]) -> Scenery:
    """Scenery of several worlds. Worlds with fewer walls are padded with far-away walls of zero size."""
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
    """Scenery with only the walls that can occlude something near the robots during one sample time.

    The number of walls is padded to 0, 16, 64, 256, ... with far-away walls of zero size, which limits the number of
    recompilations.

    Args:
        scenery: scenery with all walls.
        camera: camera, whose range selects the walls.
        robot_pose: poses of the robots in {W} [m, rad].
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
    """Whether at least one tag of each object is in the field of view, in range and not occluded.

    Args:
        camera: camera limits.
        scenery: geometry of objects and walls.
        robot_pose: true robot poses in {W} [m, rad].
        object_pose: true object poses in {W} [m, rad].
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
