"""Objects from an object file, as plant/mesh.py writes it: their conditions and their MJCF."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.condition import Condition

_FOOT = 0.01
"""Radius of the spheres an object without wheels slides on [m]."""
_SWIVEL = {"damping": 0.01, "armature": 0.001}
_ROLL = {"damping": 0.001, "armature": 0.0005}


def read_object(path: str | Path) -> dict[str, Any]:
    """The object file as plain data.

    Raises:
        ShmooError: the file is missing or not one that ``shmoo object add`` wrote.
    """
    try:
        data = json.loads(Path(path).read_text())
        if data["schema"] != 1 or not {"size", "mass", "hull", "feet", "wheels"} <= data.keys():
            raise KeyError
    except FileNotFoundError as error:
        raise ShmooError(f"object file {path} does not exist; make it with shmoo object add.") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ShmooError(f"{path} is not an object file; make it with shmoo object add.") from error
    return data


def custom_condition(path: str, seed: int) -> dict[str, Any]:
    """Values of a custom object's condition: what its file says; the seed draws only the casters' starting angles."""
    data = read_object(path)
    wheels = 0 if data["wheels"] == "none" else len(data["feet"])
    casters = wheels - (2 if data["wheels"] == "rear" else 0)
    angles = np.random.default_rng([13, seed]).uniform(-np.pi, np.pi, casters)
    return {
        "family": path,
        "seed": seed,
        "size": tuple(data["size"]),
        "mass": data["mass"] - wheels * _wheel_mass(data),
        "payload": 0.0,
        "payload_x": 0.0,
        "payload_y": 0.0,
        "friction": data["friction"],
        "rolling": (data["rolling"],) * wheels,
        "swivel_friction": data["swivel_friction"] if casters else 0.0,
        "locked": (False,) * wheels,
        "caster_angle": tuple(np.round(angles, 6).tolist()),
    }


def _wheel_mass(data: Mapping[str, Any]) -> float:
    """Mass of one wheel with its fork [kg]: 0.4, less for a light object."""
    return min(0.4, 0.05 * data["mass"])


def custom_spec(condition: Condition) -> mujoco.MjSpec:
    """MJCF of a custom object: hull as a convex mesh, feet or wheels below. Its root body is ``object`` at {O}."""
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
        # A body of its own: the root's mass is given, not summed over its geoms.
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
                solimp=[0, 0.95, 0.002, 0.5, 2],  # box.xml says why
            )  # fmt: skip
    else:
        _add_wheels(root, condition, data)
    return spec


def _add_wheels(root: Any, c: Condition, data: Mapping[str, Any]) -> None:
    radius, mass = data["wheel_radius"], _wheel_mass(data)
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
            solimp=[0.985, 0.985, 0.001, 0.5, 2],  # cart.xml says why
            rgba=[0.8, 0.1, 0.1, 1] if c.locked[i] else [0.12, 0.12, 0.13, 1],
        )  # fmt: skip
