"""Lines of sight among rectangles on the plane: walls and the footprints of objects."""

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
    """Distance [m] along rays to the first of some rectangles, ``reach`` where none is nearer.

    Args:
        origins: in {W}.
        directions: unit vectors in {W}.
        poses: of the rectangles in {W}.
        half_extents: along their own axes [m].
        reach: of the rays [m].
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
    """Whether each of K boxes that stand on the floor lies between the eye and each of R points.

    Args:
        eye: (x, y, z) in {W} [m].
        points: in {W} [m].
        poses: of the boxes' footprints in {W}.
        half_extents: along their own axes [m].
        tops: their heights [m]; infinite for what nothing looks over.
    """
    xp = se2.array_module(eye, points, poses, half_extents)
    along = points - eye[:, None]
    enter, leave = _crossing(eye[:, :2], along[..., :2], poses, half_extents)
    enter, leave = xp.maximum(enter, 0.0), xp.minimum(leave, 1.0)
    # A straight line is lowest where it enters or where it leaves.
    lowest = eye[:, None, None, 2] + xp.minimum(enter * along[:, None, :, 2], leave * along[:, None, :, 2])
    return (leave > enter) & (lowest < tops[..., None])


def _crossing(origins: Array, along: Array, poses: Array, half_extents: Array) -> tuple[Array, Array]:
    """Where lines enter and leave rectangles ``[W, K, R]``, in units of ``along [W, R, 2]``; see :func:`cast`."""
    xp = se2.array_module(origins, along, poses, half_extents)
    origin = se2.inverse_transform_point(poses, origins[:, None])[:, :, None]
    local = se2.rotate(along[:, None], -poses[:, :, None, 2])
    local = xp.where(xp.abs(local) < 1e-9, 1e-9, local)
    half = half_extents[:, :, None]
    ends = xp.stack([(-half - origin) / local, (half - origin) / local])
    return ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
