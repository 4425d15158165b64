"""Closes and orients the surface of a mesh file, so that volume, centre of mass and inertia are defined.

Mesh files are made for drawing. They contain duplicate vertices where texture or normals jump, faces without area, and
faces with the wrong winding. None of these defects may change the mass distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from shmoo_mjx.arrays import Bool, Float, Int
from shmoo_mjx.errors import ShmooError

_SAME_PLACE = 6
"""Vertices whose coordinates in metres agree to this number of decimals are merged."""
_SAMPLES = 200
"""Largest number of vertices of a body that are tested to find out whether it lies inside another body."""


class _Surface(NamedTuple):
    """Closed triangle surface: every edge belongs to exactly two faces."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]

    @property
    def corners(self) -> Float[np.ndarray, "F 3 3"]:
        return self.vertices[self.faces]


def closed_solid(parts: Sequence[Any], name: str) -> Any:
    """Join the parts of a mesh file into one closed trimesh; bodies are wound outwards, cavities inwards.

    Args:
        parts: trimeshes as loaded from the file [m].
        name: name of the file, for the error message.

    Returns:
        The joined trimesh [m].

    Raises:
        ShmooError: the surface is open or one-sided, or it is unclear which side is inside.
    """
    import trimesh

    joined = trimesh.util.concatenate([trimesh.Trimesh(p.vertices, p.faces, process=False) for p in parts])
    # Parts that are split by material are closed only when joined. Parts that touch along an edge are closed only one
    # by one. So try both.
    for group in ([joined], parts):
        surfaces = [surface for surface in map(_closed, group) if surface is not None]
        if len(surfaces) == len(group):
            break
    else:
        raise ShmooError(f"{name} is not closed (it has open edges); repair it or pass --hull to use its convex hull.")
    offsets = np.cumsum([0, *(len(s.vertices) for s in surfaces[:-1])])
    whole = _Surface(
        np.concatenate([s.vertices for s in surfaces]),
        np.concatenate([s.faces + offset for s, offset in zip(surfaces, offsets, strict=True)]),
    )
    return trimesh.Trimesh(whole.vertices, _oriented(whole, name), process=False)


def _closed(part: Any) -> _Surface | None:
    """The part without duplicate vertices and faces, or None if it is open."""
    import trimesh

    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    mesh.merge_vertices(digits_vertex=_SAME_PLACE)
    faces = np.asarray(mesh.faces)
    rows = np.sort(faces, axis=1)
    faces = faces[(rows[:, 0] != rows[:, 1]) & (rows[:, 1] != rows[:, 2])]
    _, first, times = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    # A duplicate face is either a copy (keep one) or the wall between two bodies (remove both).
    for kept in (first, first[times % 2 == 1]):
        if len(kept) and (_edges(faces[kept], len(mesh.vertices))[1] == 2).all():
            return _Surface(np.asarray(mesh.vertices, dtype=float), faces[kept])
    return None


def _edges(faces: Int[np.ndarray, "F 3"], vertices: int) -> tuple[Int[np.ndarray, "3*F"], Int[np.ndarray, "E"]]:
    """Edge index of each side of each face, and the number of faces at each edge."""
    ends = np.sort(_sides(faces), axis=1).astype(np.int64)
    _, edge, count = np.unique(ends[:, 0] * vertices + ends[:, 1], return_inverse=True, return_counts=True)
    return edge, count


def _sides(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "3*F 2"]:
    return np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)


def _oriented(surface: _Surface, name: str) -> Int[np.ndarray, "F 3"]:
    """The faces, wound so that bodies have positive volume and cavities have negative volume."""
    body, turned = _bodies(surface, name)
    surface = surface._replace(faces=_flipped(surface.faces, turned))
    a, b, c = np.moveaxis(surface.corners - surface.vertices.mean(axis=0), 1, 0)
    sign = np.sign(np.bincount(body, np.einsum("fi,fi->f", a, np.cross(b, c))))
    within = _nested(surface, body)
    wanted = np.where(within.sum(axis=1) % 2, -1, 1)
    # If the file winds a body consistently, the sign of its volume shows whether the author meant a solid or a cavity.
    # Bodies with mixed winding carry no such information.
    faces, turns = np.bincount(body), np.bincount(body, turned)
    told = (turns == 0) | (turns == faces)
    as_wanted = np.where(turns == faces, -sign, sign) == wanted
    for inner in np.flatnonzero(within.any(axis=1)):
        family = [b for b in (*np.flatnonzero(within[inner]), inner) if told[b]]
        if len(set(as_wanted[family].tolist())) > 1:
            raise ShmooError(
                f"{name} has a closed surface within another, of which it is not clear whether it is a cavity; wind "
                "cavities inwards and all else outwards, remove what lies inside, or pass --hull."
            )
    return _flipped(surface.faces, (sign != wanted)[body])


def _flipped(faces: Int[np.ndarray, "F 3"], which: Bool[np.ndarray, "F"]) -> Int[np.ndarray, "F 3"]:
    return np.where(which[:, None], faces[:, ::-1], faces)


def _bodies(surface: _Surface, name: str) -> tuple[Int[np.ndarray, "F"], Bool[np.ndarray, "F"]]:
    """Body index of each face, and which faces must be flipped so that each body has consistent winding."""
    faces = len(surface.faces)
    sides = _sides(surface.faces)
    order = np.argsort(_edges(surface.faces, len(surface.vertices))[0], kind="stable").reshape(-1, 2)
    one, other = (order // 3).T
    # Two neighbours with the same winding traverse their common edge in opposite directions.
    unlike = (sides[order[:, 0]] == sides[order[:, 1]]).all(axis=1)
    # Each face gives two graph nodes, one as it is and one flipped. Connected nodes have the same winding.
    rows = np.concatenate([one, one + faces])
    columns = np.concatenate([other + faces * unlike, other + faces * ~unlike])
    links = coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(2 * faces, 2 * faces))
    as_is, turned = connected_components(links, directed=False)[1].reshape(2, faces)
    if (as_is == turned).any():
        raise ShmooError(f"{name} has a surface without inside and outside; repair it or pass --hull.")
    return np.unique(np.minimum(as_is, turned), return_inverse=True)[1], as_is > turned


def _nested(surface: _Surface, body: Int[np.ndarray, "F"]) -> Bool[np.ndarray, "B B"]:
    """Whether a body (row) lies completely inside another body (column)."""
    corners = [surface.corners[body == b] for b in range(body.max() + 1)]
    within = np.zeros((len(corners), len(corners)), dtype=bool)
    low, high = (np.array([extreme(c, axis=(0, 1)) for c in corners]) for extreme in (np.min, np.max))
    for inner, own in enumerate(corners):
        boxed = (low <= low[inner]).all(axis=1) & (high >= high[inner]).all(axis=1)
        boxed[inner] = False
        points = np.unique(own.reshape(-1, 3), axis=0)
        points = points[:: -(-len(points) // _SAMPLES)]
        for outer in np.flatnonzero(boxed):
            within[inner, outer] = all(_encloses(corners[outer], point) for point in points)
    return within


def _encloses(corners: Float[np.ndarray, "F 3 3"], point: Float[np.ndarray, "3"]) -> bool:
    """Whether the point is inside or on a closed surface with consistent winding.

    The surface then covers a solid angle of at least half a sphere, seen from the point.
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, ac, bc = (np.einsum("fi,fi->f", u, v) for u, v in ((a, b), (a, c), (b, c)))
    triple = np.einsum("fi,fi->f", a, np.cross(b, c))
    solid_angle = 2 * np.arctan2(triple, la * lb * lc + ab * lc + ac * lb + bc * la)
    return bool(abs(solid_angle.sum()) > 2 * np.pi * (1 - 1e-6))
