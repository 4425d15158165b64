"""Objects from an object file, which plant/mesh.py writes: their properties and their MJCF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
import shapely
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial import ConvexHull, QhullError

from shmoo_mjx.arrays import Float
from shmoo_mjx.base.schema import Number, read_json, validated
from shmoo_mjx.plant.condition import Condition

_FOOT = 0.01
"""Radius of the spheres on which an object without wheels slides [m]."""
_CLOSE = 0.01
"""Tolerance between the parts of an object file [m], because the hull has fewer corners than the mesh."""
_SWIVEL = {"damping": 0.01, "armature": 0.001}
_ROLL = {"damping": 0.001, "armature": 0.0005}


Wheels = Literal["none", "casters", "rear"]
Point = tuple[Number, Number, Number]
_Side = Annotated[Number, Field(ge=0.05, le=2.5)]


class _Source(BaseModel):
    """The file from which the object was made."""

    model_config = ConfigDict(extra="forbid")
    file: str
    sha256: str


class ObjectFile(BaseModel):
    """Content of an object file: hull, mass distribution, and feet or wheels, in {O} with z = 0 on the floor."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    version: Literal[1] = Field(alias="schema")
    source: _Source | None = None
    size: tuple[_Side, _Side, _Side]
    """Length (x of {O}), width and height [m]."""
    mass: Number = Field(ge=0.5, le=500)
    """Mass of the whole object with wheels [kg]."""
    friction: Number = Field(ge=0.05, le=2)
    """Coulomb friction coefficient of feet or wheels on the floor."""
    com: Point
    """Centre of mass in {O} [m]."""
    inertia_per_mass: tuple[Number, Number, Number, Number, Number, Number]
    """Inertia about the centre of mass, divided by the mass: xx, yy, zz, xy, xz, yz [m^2]."""
    hull: tuple[Point, ...] = Field(min_length=4, max_length=1000)
    """Points whose convex hull is the shape of the object [m]."""
    feet: tuple[tuple[Number, Number], ...] = Field(min_length=3, max_length=12)
    """Positions (x, y) of feet or wheels [m]. With wheels "rear", the two fixed wheels come first."""
    wheels: Wheels
    """none, casters (a swivel caster at each foot) or rear (two fixed rear wheels, casters in front)."""
    wheel_radius: Number = Field(gt=0)
    """Radius of the wheels [m]."""
    rolling: Number = Field(ge=0, le=0.5)
    """Rolling resistance coefficient of each wheel."""
    swivel_friction: Number = Field(ge=0, le=5)
    """Dry friction of each caster's swivel [N m]."""

    @model_validator(mode="after")
    def _could_exist(self) -> ObjectFile:
        hull, feet, com, size = (np.array(v) for v in (self.hull, self.feet, self.com, self.size))
        low, high = np.array([*-size[:2] / 2, 0.0]), np.array([*size[:2] / 2, size[2]])
        if (hull < low - _CLOSE).any() or (hull > high + _CLOSE).any():
            raise ValueError("'hull' reaches out of the box of 'size' that stands on the floor; make the object again.")
        if (np.abs(feet) > size[:2] / 2 + _CLOSE).any():
            raise ValueError("'feet' has one that is not below the object; make the object again.")
        if self.wheels != "none" and self.wheel_radius >= min(size) / 2:
            raise ValueError(f"'wheel_radius' is {self.wheel_radius:g}; it must be below half the shortest side.")
        wheels = 0 if self.wheels == "none" else len(feet) * _wheel_mass(self.mass)
        if self.mass - wheels < 0.5:
            raise ValueError(f"'mass' is {self.mass:g}, of which the wheels take {wheels:g}; 0.5 kg must be left.")
        try:
            planes = ConvexHull(hull).equations
        except QhullError:
            raise ValueError("'hull' encloses no volume; give the corners of a solid.") from None
        if (planes @ [*com, 1.0]).max() > _CLOSE:
            raise ValueError(f"'com' is {list(self.com)}, outside the hull; give the centre of mass in metres.")
        moments = np.linalg.eigvalsh(inertia_matrix(self.inertia_per_mass))
        farthest = np.linalg.norm(hull - com, axis=1).max() + _CLOSE
        if not (moments[0] > 0 and moments[0] + moments[1] >= moments[2] and moments.sum() <= 2 * farthest**2):
            raise ValueError(
                f"'inertia_per_mass' is {list(self.inertia_per_mass)}, which no body in this hull has; "
                "give xx, yy, zz, xy, xz, yz about the centre of mass, divided by the mass, in m^2."
            )
        if not shapely.MultiPoint(feet).convex_hull.buffer(-0.02).contains(shapely.Point(com[:2])):
            raise ValueError("'com' is not above the feet, so it would topple; turn the object, or give --up y.")
        return self


def inertia_matrix(values: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """Symmetric matrix from its elements (xx, yy, zz, xy, xz, yz)."""
    xx, yy, zz, xy, xz, yz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def read_object(path: str | Path) -> dict[str, Any]:
    """Read an object file.

    Returns:
        Its content as plain data with the keys of `ObjectFile`.

    Raises:
        ShmooError: the file is missing or wrong; the message names the field and the remedy.
    """
    data = read_json(path, "object file", "shmoo object add")
    return validated(ObjectFile, data, path).model_dump(by_alias=True)


def custom_condition(path: str, seed: int) -> dict[str, Any]:
    """Properties of an object from a file. The seed determines only the initial angles of the casters."""
    data = read_object(path)
    wheels = 0 if data["wheels"] == "none" else len(data["feet"])
    casters = wheels - (2 if data["wheels"] == "rear" else 0)
    angles = np.random.default_rng([13, seed]).uniform(-np.pi, np.pi, casters)
    return {
        "family": path,
        "seed": seed,
        "size": tuple(data["size"]),
        "mass": data["mass"] - wheels * _wheel_mass(data["mass"]),
        "payload": 0.0,
        "payload_x": 0.0,
        "payload_y": 0.0,
        "friction": data["friction"],
        "rolling": (data["rolling"],) * wheels,
        "swivel_friction": data["swivel_friction"] if casters else 0.0,
        "locked": (False,) * wheels,
        "caster_angle": tuple(np.round(angles, 6).tolist()),
    }


def _wheel_mass(mass: float) -> float:
    """Mass of one wheel with its fork [kg]: 0.4, or 5 % of the object's mass if that is less."""
    return min(0.4, 0.05 * mass)


def custom_spec(condition: Condition) -> mujoco.MjSpec:
    """MJCF of an object from a file, with a convex mesh and feet or wheels. The root body is ``object`` at {O}."""
    data = read_object(condition.family)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    root = spec.worldbody.add_body(name="object")
    root.add_freejoint(name="object")
    root.explicitinertial = True
    root.mass, root.ipos = condition.mass, data["com"]
    root.fullinertia = condition.mass * np.array(data["inertia_per_mass"])
    spec.add_mesh(name="hull", uservert=np.array(data["hull"]).ravel())
    root.add_geom(
        name="hull", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hull", contype=4, conaffinity=14,
        friction=[0.4, 0.005, 0.0001], mass=0, rgba=[0.45, 0.52, 0.60, 1],
    )  # fmt: skip
    if condition.payload > 0:
        # The load is a separate body, because the root's mass is explicit and ignores its geoms.
        load = root.add_body(name="payload", pos=[condition.payload_x, condition.payload_y, data["com"][2]])
        load.add_geom(
            name="payload", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08] * 3, mass=condition.payload,
            contype=0, conaffinity=0, rgba=[0.6, 0.2, 0.2, 1],
        )  # fmt: skip
    if data["wheels"] == "none":
        for i, (x, y) in enumerate(data["feet"]):
            root.add_geom(
                name=f"foot{i}_sole", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_FOOT, 0, 0], pos=[x, y, _FOOT],
                contype=1, conaffinity=0, condim=3, friction=[condition.friction, 0.005, 0.0001], priority=1, mass=0,
                solimp=[0, 0.95, 0.002, 0.5, 2],  # explained in box.xml
            )  # fmt: skip
    else:
        _add_wheels(root, condition, data)
    return spec


def _add_wheels(root: Any, c: Condition, data: Mapping[str, Any]) -> None:
    radius, mass = data["wheel_radius"], _wheel_mass(data["mass"])
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    dry = {"solref_friction": [0.005, 1], "solimp_friction": [0.99, 0.9999, 0.001, 0.5, 2]}
    fixed = 2 if data["wheels"] == "rear" else 0
    for i, (x, y) in enumerate(data["feet"]):
        if i < fixed:
            wheel = root.add_body(name=f"wheel{i}", pos=[x, y, radius])
            share = mass
        else:
            angle = c.caster_angle[i - fixed]
            fork = root.add_body(
                name=f"wheel{i}_fork", pos=[x, y, 2.4 * radius], quat=[np.cos(angle / 2), 0, 0, np.sin(angle / 2)]
            )
            fork.add_joint(
                name=f"wheel{i}_swivel", axis=[0, 0, 1], type=hinge, frictionloss=c.swivel_friction, **_SWIVEL, **dry
            )  # fmt: skip
            end = [-0.8 * radius, 0.0, -1.4 * radius]
            fork.add_geom(
                name=f"wheel{i}_fork", type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, *end],
                size=[0.2 * radius, 0, 0], mass=0.4 * mass, contype=0, conaffinity=0,
            )  # fmt: skip
            wheel = fork.add_body(name=f"wheel{i}", pos=end)
            share = 0.6 * mass
        loss = 200.0 if c.locked[i] else 0.0
        wheel.add_joint(name=f"wheel{i}_roll", axis=[0, 1, 0], type=hinge, frictionloss=loss, **_ROLL, **dry)
        wheel.add_geom(
            name=f"wheel{i}", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0],
            contype=1, conaffinity=0, condim=6, priority=1, mass=share,
            friction=[c.friction, 0.002, c.rolling[i] * radius],
            solimp=[0.985, 0.985, 0.001, 0.5, 2],  # explained in cart.xml
            rgba=[0.8, 0.1, 0.1, 1] if c.locked[i] else [0.12, 0.12, 0.13, 1],
        )  # fmt: skip
