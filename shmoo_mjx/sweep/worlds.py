"""World i of a sweep: its object, its robot, its task, drawn from (seed, family, i) alone.

Whatever else is swept, however the worlds are cut into shards and batches: the same i gives the same world. Each
parameter has random numbers of its own, so that varying one more leaves the others as they were.
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
"""Fields of a model that an object's properties decide and physics depends on; a test looks for others."""


@dataclass(frozen=True)
class Drawn:
    """One world as drawn."""

    index: int
    values: dict[str, float]
    """Of every parameter by its name; those of the object as it is, drawn by its seed or by the sweep. Parameters that
    this family's objects don't have are missing."""
    condition: Condition
    face: np.ndarray
    """``[4]``"""
    goal: np.ndarray
    """``[3]`` of the object in {W}; the object starts at the origin."""
    robot: np.ndarray
    """``[3]`` start pose of {R} in {W}."""
    sensing: sensing.SensorDraw
    """What the robot's seed decides about its senses, for one world."""


class WorldSetup(NamedTuple):
    """W worlds as arrays with a leading axis W: all in which they differ before the first step."""

    fields: dict[str, Array]
    """Of ``mjx.Model``, by name."""
    factors: Factors
    gains: dict[str, Any]
    """``[W]`` each, of the low-level control, by name."""
    noise: Array
    """``[W, 11]`` standard deviations: lean (2), lean rate (2), object pose (3) and twist (3), force."""
    delay: Array
    """``[W]`` int, of commands, in ticks."""
    sensing: sensing.SensorDraw
    """``[W, 1]`` each: a world is a batch of one to its senses."""
    scenery: Scenery
    """``[W, 1, ...]`` each."""
    qpos: Array
    """``[W, nq]`` starting configuration."""
    face: Array
    half_extents: Array
    """``[W, 2]``"""
    goal: Array
    key: Array
    """``[W]`` of noise and controller."""


def label(family: str) -> str:
    """A family's name; of an own object its file's, wherever it lies."""
    return Path(family).stem


def draw(config: SweepConfig, family: str, index: int) -> Drawn:
    """World ``index`` of a family.

    Raises:
        ShmooError: an object that can't be, or that lacks a varied property.
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
        # What a sweep says of delays and of lean goes before the senses' own.
        own = {
            "delay.camera": TICK * int(drawn.frame_delay[0]),
            "delay.command": TICK * int(drawn.command_delay[0]) + senses.computing,
            "noise.lean": senses.lean_noise,
        }
        values |= {name: value for name, value in own.items() if name not in config.vary}
    frames = round(values["delay.camera"] / TICK)
    # A frame waits for the odometry of its time.
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
    """An object's scalar properties, by the names of their parameters."""
    flat = {k: getattr(c, k) for k in ("mass", "payload", "payload_x", "payload_y", "friction")}
    if c.rolling:
        flat |= {"rolling": float(np.mean(c.rolling)), "swivel_friction": c.swivel_friction}
    return flat


def scene_of(drawn: Drawn) -> Scene:
    """The world for MJX, without what ``WorldSetup.factors`` changes of the robot."""
    placed, robot = [(drawn.condition, (0.0, 0.0, 0.0))], drawn.robot.tolist()
    return build_scene(placed, robot, engine="mjx", adjust=_every_wheel_has_friction)


def _every_wheel_has_friction(spec: mujoco.MjSpec) -> None:
    """MJX compiles in which joints have dry friction: a wheel without gets a trace, so that another may be locked."""
    for joint in spec.joints:
        if joint.name.startswith("object") and joint.name.endswith("_roll"):
            joint.frictionloss = max(float(np.max(joint.frictionloss)), 1e-6)


def set_up(config: SweepConfig, worlds: Sequence[Drawn], nominal: Any, scene: Scene) -> WorldSetup:
    """Worlds of one family as arrays, with fields shaped like those of ``nominal``, the ``mjx.Model`` of ``scene``."""
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
        object_mass=one,  # the object's own are in its model
        drive_friction=column("robot.drive_friction"),
        body_com=column("robot.com_x", "robot.com_y", "robot.com_z"),
        hand_friction=column("robot.hand_friction"),
        torque_gain=column("robot.torque_gain"),
        object_friction=one,
    )


def _single(each: list[Any]) -> Any:
    """Trees of one world each as one tree ``[W, 1, ...]`` of float32 and int32."""

    def stack(*leaves: Any) -> np.ndarray:
        stacked = np.stack(leaves)
        return stacked.astype(np.int32 if np.issubdtype(stacked.dtype, np.integer) else np.float32)

    return jax.tree.map(stack, *each)


def _stacked(values: list[Any], like: Array) -> np.ndarray:
    shape, dtype = np.shape(like), np.asarray(like).dtype
    return np.stack([np.asarray(v).reshape(shape) for v in values]).astype(dtype)


def _same_structure(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    """What MJX compiles into the program must not differ between the worlds."""
    same = (model.nq, model.nv, model.ngeom) == (other.nq, other.nv, other.ngeom)
    assert same and np.array_equal(model.dof_frictionloss > 0, other.dof_frictionloss > 0)
