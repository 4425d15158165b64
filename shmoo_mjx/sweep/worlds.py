"""Draws world i of a sweep (object, robot and task) from (seed, family, i) only.

World i is therefore independent of the division into shards and batches. Each parameter has its own random numbers, so
varying another parameter does not change the values of the others.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.randomize import Factors
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.sensing import senses as sensing
from shmoo_mjx.sensing import senses_named
from shmoo_mjx.sensing.camera import Scenery, scenery_of
from shmoo_mjx.sensing.odometry import TICK
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.parameters import PARAMETERS

_OBJECT = "object."
_FIELDS = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_subtreemass", "body_inertia",
    "body_invweight0", "dof_invweight0", "dof_frictionloss", "dof_M0", "geom_pos", "geom_size", "geom_aabb",
    "geom_rbound", "geom_friction",
)  # fmt: skip
"""Model fields that depend on the object's properties and affect the physics. A test checks that none is missing."""


@dataclass(frozen=True)
class Drawn:
    """One drawn world."""

    index: int
    """Index i of the world in the sweep."""
    values: dict[str, float]
    """Value of every parameter by name, drawn by the sweep or by the object's seed. Parameters that objects of this
    family lack are missing."""
    condition: Condition
    """Condition of the object."""
    face: np.ndarray
    """Pushed face in {O}, ``[4]``, in the format of `faces_of`."""
    goal: np.ndarray
    """Goal pose of the object in {W} [m, rad], ``[3]``. The object starts at the origin."""
    robot: np.ndarray
    """Initial pose of {R} in {W} [m, rad], ``[3]``."""
    sensing: sensing.SensorDraw
    """Sensor parameters drawn from the robot's seed, for one world."""


class WorldSetup(NamedTuple):
    """All differences between W worlds before the first step, as arrays with a leading axis W."""

    fields: dict[str, Array]
    """Fields of ``mjx.Model`` by name."""
    factors: Factors
    """Factors on the robot's nominal properties."""
    gains: dict[str, Any]
    """Gains of the low-level control by name, ``[W]`` each."""
    noise: Array
    """Standard deviations of lean (2), lean rate (2), object pose (3), object twist (3) and force, ``[W, 11]``."""
    delay: Array
    """Command delay [ticks], ``[W]`` int."""
    sensing: sensing.SensorDraw
    """Drawn sensor parameters, fields ``[W, 1]``: the sensing code sees each world as a batch of one."""
    scenery: Scenery
    """Geometry for lines of sight, fields ``[W, 1, ...]``."""
    qpos: Array
    """Initial configuration, ``[W, nq]``."""
    face: Array
    """Pushed face in {O}, ``[W, 4]``."""
    half_extents: Array
    """Half extents of the object's footprint [m], ``[W, 2]``."""
    goal: Array
    """Goal pose of the object in {W} [m, rad], ``[W, 3]``."""
    key: Array
    """Random keys for noise and controller, ``[W]``."""


def label(family: str) -> str:
    """Name of a family; for a custom object, its file name without folder and suffix."""
    return Path(family).stem


def draw(config: SweepConfig, family: str, index: int) -> Drawn:
    """Draw one world of a sweep.

    Args:
        config: configuration of the sweep.
        family: family of the object.
        index: index i of the world.

    Raises:
        ShmooError: the object's properties are out of range, or the object lacks a varied property.
    """
    named = zlib.crc32(label(family).encode())
    values = {}
    for name, parameter in PARAMETERS.items():
        if name in config.vary:
            rng = np.random.default_rng([config.seed, named, index, zlib.crc32(name.encode())])
            values[name] = config.vary[name].at(rng, parameter.low, parameter.high)
        elif parameter.default is not None:
            values[name] = parameter.default
    senses = senses_named(config.senses)
    seed = int(np.random.default_rng([config.seed, named, index, zlib.crc32(b"senses")]).integers(2**31))
    drawn = sensing.draw(senses, [seed])
    if not senses.perfect:
        # Use the sensing settings' delays and lean noise only where the sweep does not vary them.
        own = {
            "delay.camera": TICK * int(drawn.frame_delay[0]),
            "delay.command": TICK * int(drawn.command_delay[0]) + senses.computing,
            "noise.lean": senses.lean_noise,
        }
        values |= {name: value for name, value in own.items() if name not in config.vary}
    frames = round(values["delay.camera"] / TICK)
    # A frame can only be processed when the odometry of its time has arrived.
    frames = frames if senses.perfect else max(frames, int(drawn.odometry.delay[0]))
    drawn = drawn._replace(frame_delay=np.array([frames]))
    condition = _condition(config, family, index, values)
    face = faces_of(condition.half_extents)[config.face]
    along = face[2] + values["goal.bearing"]
    goal = values["goal.distance"] * np.array([np.cos(along), np.sin(along)])
    robot = stand_off(np.zeros(3), face, values["start.gap"], values["start.lateral"])
    robot[2] += values["start.yaw"]
    actual = values | {_OBJECT + k: v for k, v in _properties(condition).items()}
    return Drawn(index, actual, condition, face, np.array([*goal, 2 * values["goal.bearing"]]), robot, drawn)


def _condition(config: SweepConfig, family: str, index: int, values: dict[str, float]) -> Condition:
    seed = config.first_object + index
    plain = draw_condition(family, seed)
    properties: dict[str, Any] = {k.removeprefix(_OBJECT): v for k, v in values.items() if k.startswith(_OBJECT)}
    absent = [k for k in properties if k in ("rolling", "swivel_friction") and not plain.rolling]
    if absent:
        raise ShmooError(f"vary: {_OBJECT}{absent[0]} is varied, but a {label(family)} has no wheels; leave it out.")
    if "rolling" in properties:
        properties["rolling"] = (properties["rolling"],) * len(plain.rolling)
    return draw_condition(family, seed, properties)


def _properties(c: Condition) -> dict[str, float]:
    """Scalar properties of an object, by the names of their parameters."""
    flat = {k: getattr(c, k) for k in ("mass", "payload", "payload_x", "payload_y", "friction")}
    if c.rolling:
        flat |= {"rolling": float(np.mean(c.rolling)), "swivel_friction": c.swivel_friction}
    return flat


def scene_of(drawn: Drawn) -> Scene:
    """MJX scene of a world, with the nominal robot: ``WorldSetup.factors`` are applied later."""
    placed, robot = [(drawn.condition, (0.0, 0.0, 0.0))], drawn.robot.tolist()
    return build_scene(placed, robot, engine="mjx", adjust=_every_wheel_has_friction)


def _every_wheel_has_friction(spec: mujoco.MjSpec) -> None:
    """Give every wheel at least a tiny dry friction.

    MJX fixes the set of joints with dry friction at compile time, and in other worlds these wheels may be locked.
    """
    for joint in spec.joints:
        if joint.name.startswith("object") and joint.name.endswith("_roll"):
            joint.frictionloss = max(float(np.max(joint.frictionloss)), 1e-6)


def set_up(config: SweepConfig, worlds: Sequence[Drawn], nominal: Any, scene: Scene) -> WorldSetup:
    """Convert drawn worlds of one family to arrays.

    Args:
        config: configuration of the sweep.
        worlds: drawn worlds.
        nominal: ``mjx.Model`` of ``scene``, which defines shapes and types of the model fields.
        scene: scene with the structure of all worlds.
    """
    scenes = [scene_of(w) for w in worlds]
    models = [s.model for s in scenes]
    for model in models:
        _same_structure(model, scene.model)
    fields: dict[str, Array] = {f: _stacked([getattr(m, f) for m in models], getattr(nominal, f)) for f in _FIELDS}
    fields["stat.meaninertia"] = _stacked([m.stat.meaninertia for m in models], nominal.stat.meaninertia)

    def column(*names: str) -> np.ndarray:
        values = np.array([[w.values[n] for n in names] for w in worlds], dtype=np.float32)
        return values[:, 0] if len(names) == 1 else values

    lean, force = column("noise.lean")[:, None], column("noise.force")[:, None]
    pose = column("noise.position", "noise.position", "noise.yaw")
    twist = column("noise.velocity", "noise.velocity", "noise.yaw_rate")
    gains = [n for n in PARAMETERS if n.startswith("gains.")]
    family = zlib.crc32(label(worlds[0].condition.family).encode())
    indices = jnp.asarray([w.index for w in worlds], dtype=jnp.uint32)
    return WorldSetup(
        fields=fields,
        factors=_factors(column),
        gains={n.removeprefix("gains."): column(n) for n in gains},
        noise=np.concatenate([lean, lean, 5 * lean, 5 * lean, pose, twist, force], axis=1),
        delay=np.round(column("delay.command") / TICK).astype(np.int32),
        sensing=_single([w.sensing for w in worlds]),
        scenery=_single([scenery_of([s]) for s in scenes]),
        qpos=np.stack([s.qpos0 for s in scenes]).astype(np.float32),
        face=np.stack([w.face for w in worlds]).astype(np.float32),
        half_extents=np.array([w.condition.half_extents for w in worlds], dtype=np.float32),
        goal=np.stack([w.goal for w in worlds]).astype(np.float32),
        key=jax.vmap(partial(jax.random.fold_in, jax.random.fold_in(jax.random.key(config.seed), family)))(indices),
    )


def _factors(column: Any) -> Factors:
    one = np.ones_like(column("robot.body_mass"))
    return Factors(
        body_mass=column("robot.body_mass"),
        arm_mass=column("robot.arm_mass"),
        object_mass=one,  # the model fields already contain the object's properties
        drive_friction=column("robot.drive_friction"),
        body_com=column("robot.com_x", "robot.com_y", "robot.com_z"),
        hand_friction=column("robot.hand_friction"),
        torque_gain=column("robot.torque_gain"),
        object_friction=one,
    )


def _single(each: list[Any]) -> Any:
    """Stack trees of one world each into one tree ``[W, 1, ...]`` of float32 and int32."""

    def stack(*leaves: Any) -> np.ndarray:
        stacked = np.stack(leaves)
        return stacked.astype(np.int32 if np.issubdtype(stacked.dtype, np.integer) else np.float32)

    return jax.tree.map(stack, *each)


def _stacked(values: list[Any], like: Array) -> np.ndarray:
    shape, dtype = np.shape(like), np.asarray(like).dtype
    return np.stack([np.asarray(v).reshape(shape) for v in values]).astype(dtype)


def _same_structure(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    """Assert that two models agree in everything that MJX compiles into the program."""
    same = (model.nq, model.nv, model.ngeom) == (other.nq, other.nv, other.ngeom)
    assert same and np.array_equal(model.dof_frictionloss > 0, other.dof_frictionloss > 0)
