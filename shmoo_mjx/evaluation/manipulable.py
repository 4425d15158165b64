"""Ground truth of manipulability, measured with the plant alone, and random objects on both sides of its border.

No model, planner or controller of the system takes part. The robot leans into the object up to the limit of the pushing
controller. The displacement of the object along the push is the ground truth for the decisions of the system.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of, heading, stand_off
from shmoo_mjx.geometry.hands import HAND_HEIGHT, HAND_RADIUS, REACH
from shmoo_mjx.planning.reach import MOVES, TURNS
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.types import DT, Command, Observation

IMMOVABLE = ("heavy", "brakes", "fixed")
"""Kinds of objects that the robot should not be able to move: too heavy, two wheels locked, fixed to the floor."""


BORDER = (0.2, 0.5)
"""Progress that counts as near the border of manipulability [m]: the threshold of 0.316 m, 1.6 times less or more."""

STRATA = {"drawn": "as drawn", "border": "near the border"}
"""Strata by name: objects as drawn, and objects near the border of manipulability."""

HEAVIEST = 450.0
"""Maximum load of an object near the border [kg]."""


@dataclass(frozen=True)
class SteadyPush:
    """Settings of the robot's strongest steady push."""

    lean: float = 0.15
    """Lean towards the object at low speed: the lean limit of the pushing controller [rad]."""
    speed: float = 0.25
    """Speed of the robot at which the lean command reaches zero: the speed limit of the pushing controller [m/s]."""
    seconds: float = 6.5
    """Duration from the first contact [s]: about 1.5 s for the lean to grow, then the planning horizon of 5 s."""
    distance: float = MOVES
    """Progress along the push from which an object counts as manipulable [m]."""
    turn: float = TURNS
    """Rotation of the object at which the push ends [rad]."""
    touch: float = 5.0
    """Hand force that counts as the first contact [N]."""


@cache
def steady_push(condition: Condition, side: int, cfg: SteadyPush = SteadyPush()) -> float:
    """Progress of an object along the strongest steady push on one face [m].

    The push ends once the object has moved by ``cfg.distance`` or turned by ``cfg.turn``, once the robot has fallen, or
    after ``cfg.seconds`` of contact.

    Args:
        condition: object, alone on an open floor.
        side: index of the face in `faces_of`.
        cfg: settings of the push.
    """
    face = faces_of(condition.half_extents)[side]
    start = stand_off(np.zeros(3), face, 0.10)
    engine = MujocoEngine([build_scene([(condition, (0.0, 0.0, 0.0))], start.tolist())])
    world = engine.init()
    obs = engine.observe(world)
    lean, moved, time = np.zeros(2), 0.0, float(np.asarray(obs.time)[0])
    contact: float | None = None
    while moved < cfg.distance and time < cfg.seconds + 12.0:
        if contact is None and np.hypot(*obs.wrench[0, 0, :2]) > cfg.touch:
            contact = time
        if contact is not None and time - contact >= cfg.seconds:
            break
        touching = np.array([contact is not None])
        lean = steady_lean(cfg, obs, obs.object_pose[:, 0], face[None], last=lean[None], touching=touching)[0]
        u, yaw = np.array([[*lean, 0.0]]), np.array([heading(obs.object_pose[0, 0], face)])
        world, obs = engine.step(world, Command(u, yaw, np.array([REACH]), np.array([HAND_HEIGHT])))
        pose, time = obs.object_pose[0, 0], float(np.asarray(obs.time)[0])
        if engine.fallen(world)[0] or abs(float(se2.wrap(pose[2]))) > cfg.turn:
            break
        moved = float(pose[0] * np.cos(face[2]) + pose[1] * np.sin(face[2]))
    engine.close()
    return moved


def steady_lean(
    cfg: SteadyPush,
    obs: Observation,
    objects: Float[Array, "W 3"],
    faces: Float[Array, "W 4"],
    *,
    last: Float[Array, "W 2"],
    touching: Bool[Array, "W"],
    lateral: Float[Array, "W"] | float = 0.0,
) -> Float[np.ndarray, "W 2"]:
    """Lean commands of a steady push in {R} [rad].

    The robot stands still for 1.5 s, moves slowly forward, and then leans into the object.

    Args:
        cfg: settings.
        obs: observation of W worlds.
        objects: poses of the pushed objects in {W}.
        faces: pushed faces in {O}, rows of `faces_of` or `corners_of`.
        last: lean commands of the last sample [rad].
        touching: whether each object has been touched.
        lateral: lateral position to keep, from the centre of the face to the robot's left [m].
    """
    in_face = se2.relative(se2.compose(objects, faces[:, :3]), obs.robot_pose)
    velocity = se2.rotate(obs.robot_twist[:, :2], -obs.robot_pose[:, 2])
    ahead = np.where(np.asarray(obs.time) < 1.5, 0.0, 0.12)
    wish = np.stack([ahead, np.clip(-0.8 * (in_face[:, 1] - lateral), -0.1, 0.1)], axis=-1)
    lean = np.array(velocity_to_lean(Gains(), velocity, obs.lean_rate, wish))
    full = cfg.lean * np.clip((cfg.speed - velocity[:, 0]) / 0.1, -0.5, 1.0)
    off = -in_face[:, 0] - REACH - HAND_RADIUS > 0.10
    # Hands more than 0.1 m away from the face approach it at 0.12 m/s. Otherwise the lean grows by at most 0.1 rad/s.
    grown = last[:, 0] + np.clip(full - last[:, 0], -0.2 * DT, 0.1 * DT)
    lean[:, 0] = np.where(touching & ~off, grown, lean[:, 0])
    return lean


def manipulable(condition: Condition, side: int = 0, cfg: SteadyPush = SteadyPush()) -> bool:
    """Whether the robot's steady push on face ``side`` moves the object by at least ``cfg.distance`` along the push."""
    return steady_push(condition, side, cfg) >= cfg.distance


def near_border(condition: Condition, side: int = 0, cfg: SteadyPush = SteadyPush()) -> bool:
    """Whether the steady push on face ``side`` moves the object by a distance within `BORDER`.

    A little more lean or time would change the verdict there, so a wrong decision means less than elsewhere.
    """
    if not manipulable(condition, side, cfg):
        return steady_push(condition, side, cfg) >= BORDER[0]
    # A push ends at the threshold, so only a longer push shows how far the object moves.
    return steady_push(condition, side, replace(cfg, distance=BORDER[1])) < BORDER[1]


def draw_immovable(kind: str, family: str, seed: int) -> Condition:
    """An object of a kind that should not move. Only a push in the plant shows whether it does.

    Args:
        kind: heavy (a load of 1.5 to 4 times what the robot can push), brakes (two wheels locked, a person's load) or
            fixed (to the floor: so heavy and so rough that nothing moves it).
        family: family of the object. A box has no brakes and is drawn heavy instead.
        seed: seed of all random properties.
    """
    rng = np.random.default_rng([seed, IMMOVABLE.index(kind)])
    drawn = draw_condition(family, seed)
    if kind == "fixed":
        locked = {"locked": [True] * len(drawn.locked)} if drawn.locked else {}
        return draw_condition(family, seed, {"mass": 400.0, "payload": 400.0, "friction": 2.0, **locked})
    if kind == "brakes" and family != "box":
        pairs = [(0, 1), (0, 2), (1, 3), (2, 3)] if family == "cart" else [(0, 1)]
        pair = pairs[rng.integers(len(pairs))]
        properties = {"locked": [i in pair for i in range(4)], "payload": float(rng.uniform(30.0, 90.0))}
        return draw_condition(family, seed, properties)
    if family == "box":
        return draw_condition(family, seed, {"mass": float(rng.uniform(30.0, 90.0)), "friction": drawn.friction})
    return draw_condition(family, seed, {"payload": float(rng.uniform(200.0, 450.0)), "rolling": [0.08] * 4})


def near_border_by_load(
    condition: Condition, side: int, moves: bool, cfg: SteadyPush = SteadyPush()
) -> Condition | None:
    """The object with a load for which the steady push on face ``side`` moves it by a distance within `BORDER`.

    Args:
        condition: object. Bisection changes its load and keeps everything else.
        side: index of the pushed face in `faces_of`.
        moves: True for a progress from the threshold up, False for a progress below the threshold.
        cfg: settings of the push.

    Returns:
        The object; None if the bisection finds no such load up to `HEAVIEST`.
    """
    nearest, farthest = (cfg.distance, BORDER[1]) if moves else (BORDER[0], cfg.distance)
    light, heavy = 0.0, HEAVIEST
    # Twelve steps resolve 0.1 kg. Any load within the band is accepted. The progress of an object that starts to stick
    # jumps, so the band may stay empty.
    for _ in range(12):
        load = round((light + heavy) / 2, 3)
        moved = steady_push(replace(condition, payload=load), side, replace(cfg, distance=farthest))
        if nearest <= moved < farthest:
            return replace(condition, payload=load)
        light, heavy = (load, heavy) if moved >= farthest else (light, load)
    return None
