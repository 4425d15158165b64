"""Builds one MuJoCo model from robot, objects and walls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import mujoco
import numpy as np

from shmoo_mjx.arrays import Array, Float, Int
from shmoo_mjx.base.assets import asset
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import TUCKED_HEIGHT, TUCKED_REACH, hand_targets
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import object_spec
from shmoo_mjx.plant.robot import Robot, arm_joints, shmoobot, with_arms

WALL_HEIGHT = 1.3
"""Height of the simulated walls [m], above the robot's height."""

_HANDS = ("left_hand", "right_hand")
# Colliding geoms of each part.
_SHAPES = {
    "torso": ("torso_hull",),
    "ball": ("ball",),
    "left_arm": ("left_upper_arm", "left_forearm"),
    "right_arm": ("right_upper_arm", "right_forearm"),
    "left_hand": ("left_hand",),
    "right_hand": ("right_hand",),
}
PARTS = tuple(_SHAPES)
"""Parts of the robot for which wall contacts are reported. An arm consists of upper arm and forearm."""
_RARE_BIT = 8  # models_xml/shmoobot.xml explains the bits
_FOUND = 1 << 0  # mjCONDATA bit: number of contacts
_FORCE_TORQUE_POSITION = (1 << 1) | (1 << 2) | (1 << 4)  # mjCONDATA bits of a contact sensor: force, torque, pos
_NET_FORCE = 3  # mjREDUCE: one wrench for all contacts of a pair, in {W}
_FRAME = (1 << 5) | (1 << 6)  # mjCONDATA bits: normal, tangent
_NEAREST = 1  # mjREDUCE: the deepest contact of a pair, in its own frame


@dataclass(frozen=True)
class Scene:
    """A compiled world, with the indices of its parts in MuJoCo's arrays."""

    model: mujoco.MjModel
    """Compiled model."""
    conditions: tuple[Condition, ...]
    """Condition of each object."""
    object_qpos: Int[np.ndarray, "N"]
    """First index of each object's free joint in qpos."""
    object_qvel: Int[np.ndarray, "N"]
    """First index of each object's free joint in qvel."""
    contact_sensor: Int[np.ndarray, "N 2"]
    """First index in sensordata of (force, torque, position), for each object and hand (left, right)."""
    part_of_geom: Int[np.ndarray, "ngeom"]
    """Index into PARTS for the robot's colliding geoms, -1 for all other geoms."""
    wall_geoms: frozenset[int]
    """Ids of the walls' geoms."""
    wall_sensor: Int[np.ndarray, "P 2"] | Int[np.ndarray, "P 0"]
    """Index in sensordata of the number of wall contacts, for both geoms of each of PARTS (twice the same index if a
    part has one geom). Empty without walls and for MJX, whose contact sensors do not support bodies."""
    qpos0: Float[np.ndarray, "nq"]
    """Initial configuration."""
    robot: Robot
    """Nominal robot, without the changes that ``adjust`` makes."""
    spec: mujoco.MjSpec | None
    """Specification of robot, objects and their sensors, without walls. None in a pickled copy, because MuJoCo can't
    copy it."""
    walls: Float[np.ndarray, "K 4"]
    """Boxes (centre x, centre y, half length x, half length y) [m]; centres in {W}, lengths along the map's axes."""
    wall_yaw: float = 0.0
    """Yaw of the map's axes in {W} [rad]."""
    framed: bool = False
    """Whether the hands' contact sensors report in the contact frame, with normal and tangent after the position. MJX
    offers no net wrench. A hand is a sphere and has one contact with a convex hull, so both forms agree."""

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"spec": None}

    def model_near(self, places: Float[np.ndarray, "n 2"], reach: Float[np.ndarray, "n"]) -> mujoco.MjModel:
        """Compile the same world with nearby walls only, and without drawn walls.

        MuJoCo checks every wall in every step, so the thousands of walls of a building would dominate the run time.
        States and sensors have the same layout as in ``model``. The physics is the same as long as nothing moves
        farther than ``reach``.

        Args:
            places: points in {W} [m].
            reach: distance from each point within which walls are kept [m].
        """
        assert self.spec is not None, "a copied scene has its whole model alone"
        spec = self.spec.copy()
        offset = se2.rotate(places[:, None] - self.walls[:, :2], np.array(-self.wall_yaw))
        apart = np.linalg.norm(np.maximum(np.abs(offset) - self.walls[:, 2:], 0.0), axis=-1)
        near = (apart <= reach[:, None]).any(axis=0)
        _add_walls(spec, self.walls[near], self.wall_yaw)
        return spec.compile()

    def placed(self, robot_pose: Any, object_poses: Any) -> Float[np.ndarray, "nq"]:
        """Initial configuration with robot and objects at the given poses (x, y, yaw) in {W} [m, rad]."""
        qpos = self.qpos0.copy()
        qpos[:7] = _free(robot_pose, qpos[2])
        qpos[3:7] = _balanced(self.robot, qpos[3:7], arm_joints(qpos))
        for adr, pose in zip(self.object_qpos, object_poses, strict=True):
            qpos[adr : adr + 7] = _free(pose, qpos[adr + 2])
        return qpos


def build_scene(
    objects: Sequence[tuple[Condition, Sequence[float] | Float[Array, "3"]]] = (),
    robot_pose: Sequence[float] | Float[Array, "3"] = (0.0, 0.0, 0.0),
    walls: Sequence[tuple[float, float, float, float]] = (),
    wall_yaw: float = 0.0,
    *,
    wall_height: float = 0.6,
    engine: Literal["mujoco", "mjx"] = "mujoco",
    robot: Robot | None = None,
    adjust: Callable[[mujoco.MjSpec], None] = lambda spec: None,
) -> Scene:
    """Build a scene of one robot, objects and walls.

    Args:
        objects: condition and pose (x, y, yaw) in {W} [m, rad] of each object.
        robot_pose: pose (x, y, yaw) of {R} in {W} [m, rad].
        walls: boxes (centre x, centre y, half length x, half length y) [m]; centres in {W}, lengths along the map's
            axes.
        wall_yaw: yaw of the map's axes in {W} [rad].
        wall_height: height to which walls are drawn [m]. Simulated walls have the height WALL_HEIGHT.
        engine: engine for which contact sensors are built. MJX computes every possible contact, so for MJX some rare
            contacts are removed: those of a fallen robot or object with the floor, and those of an arm or the ball with
            an object. In all other situations the physics is the same.
        robot: robot, by default Shmoobot.
        adjust: function that changes the MJCF in place before it is compiled (used by plant/perturbation.py).

    Raises:
        ShmooError: a pose is not three finite numbers.
    """
    poses = {"robot_pose": robot_pose} | {f"the pose of objects[{i}]": pose for i, (_, pose) in enumerate(objects)}
    for name, pose in poses.items():
        if np.shape(pose) != (3,) or not np.isfinite(pose).all():
            raise ShmooError(f"build_scene: {name} is {pose}; give three finite numbers, x, y [m] and yaw [rad].")
    framed, robot = engine == "mjx", robot or shmoobot()
    boxes = np.array(walls, dtype=float).reshape(-1, 4)
    spec = mujoco.MjSpec.from_file(str(asset("models_xml/scene.xml")))
    spec.attach(mujoco.MjSpec.from_file(str(robot.mjcf)), prefix="robot/", frame=spec.worldbody.add_frame())
    for i, (condition, _) in enumerate(objects):
        spec.attach(object_spec(condition), prefix=f"object{i}/", frame=spec.worldbody.add_frame())
        _add_hand_sensors(spec, i, framed)
    if framed:
        _drop_idle_contacts(spec)
    else:
        # With sleeping enabled, objects at rest cost no time until something touches them.
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    adjust(spec)
    whole = spec.copy()
    if len(boxes):
        _add_walls(whole, boxes, wall_yaw, drawn=wall_height, sensors=not framed)
    return _index(
        whole.compile(), spec, robot, objects=objects, robot_pose=robot_pose, walls=(boxes, wall_yaw), framed=framed
    )


def _add_hand_sensors(spec: mujoco.MjSpec, index: int, framed: bool) -> None:
    """Add sensors of the contact between object ``index`` and each arm: the whole arm in C, only the hand in MJX."""
    for hand in _HANDS:
        arm = hand.replace("hand", "upper_arm")
        spec.add_sensor(
            name=f"object{index}/{hand}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            # An "xbody" is a body together with all its descendants.
            objtype=mujoco.mjtObj.mjOBJ_GEOM if framed else mujoco.mjtObj.mjOBJ_XBODY,
            objname=f"robot/{hand if framed else arm}",
            reftype=mujoco.mjtObj.mjOBJ_GEOM,
            refname=f"object{index}/hull",
            intprm=[_FORCE_TORQUE_POSITION | (_FRAME if framed else 0), _NEAREST if framed else _NET_FORCE, 1],
        )


def _add_walls(
    spec: mujoco.MjSpec,
    walls: Float[np.ndarray, "K 4"],
    yaw: float,
    *,
    drawn: float | None = None,
    sensors: bool = True,
) -> None:
    """Add a body with the walls, and sensors for the contacts between it and the robot's parts.

    Args:
        spec: specification to change.
        walls: boxes, see :attr:`Scene.walls`.
        yaw: yaw of the map's axes in {W} [rad].
        drawn: height to which walls are drawn [m], below their real height so that rooms stay visible. None draws no
            walls.
        sensors: whether to add the sensors.
    """
    body = spec.worldbody.add_body(name="walls")
    box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "euler": [0, 0, yaw], "contype": 0, "material": "wall"}
    for i, (x, y, hx, hy) in enumerate(walls):
        for name, height, conaffinity, group in ((f"wall{i}", WALL_HEIGHT, 14, 3), (f"wall{i}_drawn", drawn, 0, 0)):
            if height is not None:
                place = {"pos": [x, y, height / 2], "size": [hx, hy, height / 2]}
                body.add_geom(name=name, conaffinity=conaffinity, group=group, **place, **box)
    for shapes in _SHAPES.values() if sensors else ():
        for shape in shapes:
            spec.add_sensor(
                name=f"walls/{shape}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_GEOM,
                objname=f"robot/{shape}",
                reftype=mujoco.mjtObj.mjOBJ_BODY,
                refname="walls",
                intprm=[_FOUND, 0, 1],
            )


def _drop_idle_contacts(spec: mujoco.MjSpec) -> None:
    """Disable contacts that no ordinary push makes: torso and hull with the floor, arms and ball with the hull."""
    for geom in spec.geoms:
        if geom.name.endswith("hull"):
            geom.contype &= ~1
            geom.conaffinity &= ~_RARE_BIT


def _index(
    model: mujoco.MjModel,
    spec: mujoco.MjSpec,
    robot: Robot,
    *,
    objects: Sequence[tuple[Condition, Any]],
    robot_pose: Any,
    walls: tuple[np.ndarray, float],
    framed: bool,
) -> Scene:
    joints = [model.joint(f"object{i}/object") for i in range(len(objects))]
    object_qpos = np.array([j.qposadr[0] for j in joints], dtype=int)
    sensors = [[model.sensor(f"object{i}/{hand}").adr[0] for hand in _HANDS] for i in range(len(objects))]
    part_of_geom = np.full(model.ngeom, -1)
    for part, shapes in enumerate(_SHAPES.values()):
        part_of_geom[[model.geom(f"robot/{shape}").id for shape in shapes]] = part
    touch = [
        [model.sensor(f"walls/{shapes[i]}").adr[0] for i in (0, -1)]
        for shapes in _SHAPES.values()
        if len(walls[0]) and not framed
    ]
    qpos0 = with_arms(model.qpos0, _folded_arms(robot))
    scene = Scene(
        model=model,
        conditions=tuple(c for c, _ in objects),
        object_qpos=object_qpos,
        object_qvel=np.array([j.dofadr[0] for j in joints], dtype=int),
        contact_sensor=np.array(sensors, dtype=int).reshape(-1, 2),
        part_of_geom=part_of_geom,
        wall_geoms=frozenset(model.geom(f"wall{i}").id for i in range(len(walls[0]))),
        wall_sensor=np.array(touch, dtype=int).reshape(len(PARTS), -1),
        qpos0=qpos0,
        robot=robot,
        spec=spec,
        walls=walls[0],
        wall_yaw=walls[1],
        framed=framed,
    )
    return replace(scene, qpos0=scene.placed(robot_pose, [pose for _, pose in objects]))


def _folded_arms(robot: Robot) -> np.ndarray:
    """Joint angles ``[2, 3]`` [rad] of the control's folded posture, so that the arms do not swing at the start."""
    flat = hand_targets(np.array(0.0), np.array(TUCKED_REACH))
    height = np.full((2, 1), TUCKED_HEIGHT - robot.ball_radius)
    return robot.arm_angles(np.concatenate([flat, height], axis=-1))


def _balanced(robot: Robot, quat: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """Lean the body back so that the CoM of body and arms is above the ball, like the control's feed-forward."""
    lean = -robot.com_offset(arms)[0] / robot.body_com_height
    out = np.empty(4)
    mujoco.mju_mulQuat(out, quat, np.array([np.cos(lean / 2), 0.0, np.sin(lean / 2), 0.0]))
    return out


def _free(pose: Any, z: float) -> list[float]:
    x, y, yaw = pose
    return [x, y, z, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
