"""Puts robot, objects and walls into one MuJoCo model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import mujoco
import numpy as np

from shmoo_mjx.assets import asset
from shmoo_mjx.hands import TUCKED_HEIGHT, TUCKED_REACH, hand_targets
from shmoo_mjx.plant.objects import Condition, object_spec
from shmoo_mjx.plant.robot import ROBOT, arm_angles, com_offset

__all__ = ["Scene", "build_scene"]

_HANDS = ("left_hand", "right_hand")
_FORCE_TORQUE_POSITION = (1 << 1) | (1 << 2) | (1 << 4)  # mjCONDATA bits of a contact sensor: force, torque, pos
_NET_FORCE = 3  # mjREDUCE: one wrench for all contacts of a pair, in {W}
_FRAME = (1 << 5) | (1 << 6)  # mjCONDATA bits: normal, tangent
_NEAREST = 1  # mjREDUCE: the deepest contact of a pair, in its own frame


@dataclass(frozen=True)
class Scene:
    """A compiled world and where things stand in its arrays."""

    model: mujoco.MjModel
    conditions: tuple[Condition, ...]
    object_qpos: np.ndarray
    """``[N]`` first index of each object's free joint in qpos."""
    object_qvel: np.ndarray
    """``[N]`` the same in qvel."""
    contact_sensor: np.ndarray
    """``[N, 2]`` first index in sensordata of (force, torque, position) of object x hand (left, right)."""
    robot_geoms: frozenset[int]
    """Geoms of the robot's body and hands."""
    wall_geoms: frozenset[int]
    qpos0: np.ndarray
    """``[nq]`` starting configuration."""
    framed: bool = False
    """Whether the sensors report in the contact's own frame, with normal and tangent after the position: MJX knows no
    net wrench. A hand, being a sphere, has one contact with a convex hull, so that the two agree."""

    def placed(self, robot_pose: Any, object_poses: Any) -> np.ndarray:
        """The starting configuration ``[nq]`` with robot and objects at other poses (x, y, yaw) in {W}."""
        qpos = self.qpos0.copy()
        qpos[:7] = _free(robot_pose, qpos[2])
        qpos[3:7] = _balanced(qpos[3:7], qpos[11:17])
        for adr, pose in zip(self.object_qpos, object_poses, strict=True):
            qpos[adr : adr + 7] = _free(pose, qpos[adr + 2])
        return qpos


def build_scene(
    objects: Sequence[tuple[Condition, Sequence[float]]] = (),
    robot_pose: Sequence[float] = (0.0, 0.0, 0.0),
    walls: Sequence[tuple[float, float, float, float]] = (),
    wall_yaw: float = 0.0,
    wall_height: float = 0.6,
    engine: Literal["mujoco", "mjx"] = "mujoco",
    adjust: Callable[[mujoco.MjSpec], None] = lambda spec: None,
) -> Scene:
    """A scene of Shmoobot, ``objects`` at their (x, y, yaw) in {W}, and walls.

    Args:
        objects: (condition, pose) of each object.
        robot_pose: (x, y, yaw) of {R} in {W} [m, rad].
        walls: boxes (centre x, centre y, half length x, half length y) in the map's axes [m].
        wall_yaw: yaw of the map's axes [rad]; centres are already in {W}.
        wall_height: drawn and simulated height of the walls [m].
        engine: which engine's contact sensors to build. The physics is the same until the robot falls or an object
            topples: MJX, which computes every contact that could be, leaves out those of the bodies with the floor.
        adjust: last changes to the MJCF before it is compiled, in place (plant/body.py makes another robot this way).
    """
    framed = engine == "mjx"
    spec = mujoco.MjSpec.from_file(str(asset("models_xml/scene.xml")))
    spec.attach(
        mujoco.MjSpec.from_file(str(asset("models_xml/shmoobot.xml"))),
        prefix="robot/",
        frame=spec.worldbody.add_frame(),
    )
    for i, (condition, _) in enumerate(objects):
        spec.attach(object_spec(condition), prefix=f"object{i}/", frame=spec.worldbody.add_frame())
        for hand in _HANDS:
            spec.add_sensor(
                name=f"object{i}/{hand}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_GEOM,
                objname=f"robot/{hand}",
                reftype=mujoco.mjtObj.mjOBJ_GEOM,
                refname=f"object{i}/hull",
                intprm=[
                    _FORCE_TORQUE_POSITION | (_FRAME if framed else 0),
                    _NEAREST if framed else _NET_FORCE,
                    1,
                ],
            )
    for i, (x, y, hx, hy) in enumerate(walls):
        spec.worldbody.add_geom(
            name=f"wall{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, wall_height / 2],
            size=[hx, hy, wall_height / 2],
            euler=[0, 0, wall_yaw],
            contype=0,
            conaffinity=6,
            material="wall",
        )
    if framed:
        _drop_idle_contacts(spec)
    adjust(spec)
    model = spec.compile()
    return _index(model, objects, robot_pose, len(walls), framed)


def _drop_idle_contacts(spec: mujoco.MjSpec) -> None:
    """Body against floor, hull against floor: 6 to 10 contacts that are open as long as everything stands."""
    for geom in spec.geoms:
        if geom.name.endswith("hull"):
            geom.contype &= ~1


def _index(
    model: mujoco.MjModel,
    objects: Sequence[tuple[Condition, Sequence[float]]],
    robot_pose: Sequence[float],
    walls: int,
    framed: bool,
) -> Scene:
    joints = [model.joint(f"object{i}/object") for i in range(len(objects))]
    object_qpos = np.array([j.qposadr[0] for j in joints], dtype=int)
    sensors = [[model.sensor(f"object{i}/{hand}").adr[0] for hand in _HANDS] for i in range(len(objects))]
    qpos0 = model.qpos0.copy()
    qpos0[11:17] = _folded_arms()
    scene = Scene(
        model=model,
        conditions=tuple(c for c, _ in objects),
        object_qpos=object_qpos,
        object_qvel=np.array([j.dofadr[0] for j in joints], dtype=int),
        contact_sensor=np.array(sensors, dtype=int).reshape(-1, 2),
        robot_geoms=frozenset(model.geom(f"robot/{name}").id for name in ("torso_hull", *_HANDS)),
        wall_geoms=frozenset(model.geom(f"wall{i}").id for i in range(walls)),
        qpos0=qpos0,
        framed=framed,
    )
    return replace(scene, qpos0=scene.placed(robot_pose, [pose for _, pose in objects]))


def _folded_arms() -> np.ndarray:
    """Joint angles ``[6]`` with the hands where the control holds them folded: a world starts without a swing."""
    flat = hand_targets(np.array(0.0), np.array(TUCKED_REACH))
    height = np.full((2, 1), TUCKED_HEIGHT - ROBOT.ball_radius)
    return arm_angles(np.concatenate([flat, height], axis=-1)).ravel()


def _balanced(quat: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """Lean the body back until its CoM with the arms is above the ball, as the control's feed-forward does."""
    lean = -com_offset(arms.reshape(2, 3))[0] / ROBOT.body_com_height
    out = np.empty(4)
    mujoco.mju_mulQuat(out, quat, np.array([np.cos(lean / 2), 0.0, np.sin(lean / 2), 0.0]))
    return out


def _free(pose: Sequence[float], z: float) -> list[float]:
    x, y, yaw = pose
    return [x, y, z, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
