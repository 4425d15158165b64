"""Lines of sight among rectangles in the plane: walls and the footprints of objects."""

from __future__ import annotations

from shmoo_mjx.arrays import Array, Bool, Float
from shmoo_mjx.geometry import se2


def cast(
    origins: Float[Array, "W 2"],
    directions: Float[Array, "W R 2"],
    poses: Float[Array, "W K 3"],
    half_extents: Float[Array, "W K 2"],
    *,
    reach: float,
) -> Float[Array, "W R"]:
    """Distance along each ray to the first rectangle [m].

    Args:
        origins: origins of the rays in {W} [m].
        directions: unit vectors of the rays in {W}.
        poses: poses (x, y, yaw) of the rectangles in {W} [m, rad].
        half_extents: half extents of the rectangles along their own axes [m].
        reach: length of the rays [m]; the result for a ray that hits nothing.
    """
    xp = se2.array_module(origins, directions, poses, half_extents)
    enter, leave = _crossing(origins, directions, poses, half_extents)
    distance = xp.where((leave >= enter) & (leave >= 0), xp.maximum(enter, 0.0), reach)
    return xp.minimum(distance.min(axis=1), reach)


def hidden(
    eye: Float[Array, "W 3"],
    points: Float[Array, "W R 3"],
    poses: Float[Array, "W K 3"],
    half_extents: Float[Array, "W K 2"],
    *,
    tops: Float[Array, "W K"],
) -> Bool[Array, "W K R"]:
    """Whether each of K boxes on the floor occludes each of R points from the eye.

    Args:
        eye: position (x, y, z) of the eye in {W} [m].
        points: positions of the points in {W} [m].
        poses: poses (x, y, yaw) of the boxes' footprints in {W} [m, rad].
        half_extents: half extents of the boxes along their own axes [m].
        tops: heights of the boxes [m]; infinite if the eye can never see over a box.
    """
    xp = se2.array_module(eye, points, poses, half_extents)
    along = points - eye[:, None]
    enter, leave = _crossing(eye[:, :2], along[..., :2], poses, half_extents)
    enter, leave = xp.maximum(enter, 0.0), xp.minimum(leave, 1.0)
    # A straight line has its lowest point inside the box either where it enters or where it leaves.
    lowest = eye[:, None, None, 2] + xp.minimum(enter * along[:, None, :, 2], leave * along[:, None, :, 2])
    return (leave > enter) & (lowest < tops[..., None])


def _crossing(origins: Array, along: Array, poses: Array, half_extents: Array) -> tuple[Array, Array]:
    """Line parameters ``[W, K, R]`` at which lines enter and leave rectangles, in units of ``along [W, R, 2]``."""
    xp = se2.array_module(origins, along, poses, half_extents)
    origin = se2.inverse_transform_point(poses, origins[:, None])[:, :, None]
    local = se2.rotate(along[:, None], -poses[:, :, None, 2])
    local = xp.where(xp.abs(local) < 1e-9, 1e-9, local)
    half = half_extents[:, :, None]
    ends = xp.stack([(-half - origin) / local, (half - origin) / local])
    return ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
