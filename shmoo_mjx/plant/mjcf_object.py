"""Reads an MJCF file as the geometry and mass distribution of one rigid object."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from shmoo_mjx.arrays import Float
from shmoo_mjx.errors import ShmooError

_SHAPES = (
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_MESH,
)


class Solid(NamedTuple):
    """A rigid body, in the file's axes."""

    points: Float[np.ndarray, "V 3"]
    """Surface points; their convex hull is the object's hull [m]."""
    mass: float
    """Mass [kg]."""
    com: Float[np.ndarray, "3"]
    """Centre of mass [m]."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the CoM divided by the mass [m^2]."""


def read_mjcf(path: Path) -> Solid:
    """Read an MJCF file as one rigid body; all bodies of the file are joined at their initial poses.

    The hull is made of the colliding geoms, or of all geoms if none collides. Mass and inertia are those that MuJoCo
    compiles.

    Raises:
        ShmooError: the file is missing, does not compile, contains a floor or a joint, or has no mass.
    """
    model = _compiled(path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    collides = (model.geom_contype | model.geom_conaffinity) > 0
    chosen = np.flatnonzero(collides if collides.any() else np.ones(model.ngeom, dtype=bool))
    points = [_surface(model, int(g)) @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g] for g in chosen]
    mass = float(model.body_mass.sum())
    if mass <= 0:
        raise ShmooError(f"{path.name} weighs nothing; give its geoms a density or a mass.")
    com = model.body_mass @ data.xipos / mass
    inertia = np.zeros((3, 3))
    for body in range(model.nbody):
        axes, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - com
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Solid(np.concatenate(points), mass, com, inertia / mass)


def _compiled(path: Path) -> mujoco.MjModel:
    name = path.name
    if not path.is_file():
        raise ShmooError(f"{path} does not exist; give the path of an MJCF file.")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ShmooError(f"{name} can't be read as MJCF ({reason}); correct it until MuJoCo opens it.") from None
    if model.ngeom == 0:
        raise ShmooError(f"{name} holds no geom; give the object at least one shape.")
    for g in range(model.ngeom):
        if mujoco.mjtGeom(int(model.geom_type[g])) not in _SHAPES:
            kind = mujoco.mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_").lower()
            raise ShmooError(f"{name} holds a {kind} geom; leave only the object itself, without floor or terrain.")
    for j in range(model.njnt):
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE:
            joint = model.joint(j).name or f"number {j}"
            raise ShmooError(f"{name} moves at joint {joint!r}; remove its joints, and give wheels with --wheels.")
    if model.njnt > 1:
        raise ShmooError(f"{name} holds {model.njnt} free bodies; make one file for each object.")
    return model


def _surface(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points ``[V, 3]`` of a geom's surface in its own frame."""
    import trimesh

    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        first, count = model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]]
        return np.asarray(model.mesh_vert[first : first + count], dtype=float)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.asarray(trimesh.creation.box(2 * size).vertices)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.asarray(trimesh.creation.cylinder(size[0], 2 * size[1], sections=32).vertices)
    ball = np.asarray(trimesh.creation.icosphere(subdivisions=2).vertices)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        ends = [[0, 0, size[1]], [0, 0, -size[1]]]
        return np.concatenate([size[0] * ball + end for end in ends])
    return ball * (size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
