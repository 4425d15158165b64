"""Renders a scene off-screen with MuJoCo's renderer."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Literal, NamedTuple

import mujoco
import numpy as np

from shmoo_mjx.arrays import Float, Numbers, Shaped
from shmoo_mjx.plant.scene import Scene

_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
with mujoco.Renderer(model, 16, 16) as renderer:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer.update_scene(data)
    renderer.render()
"""
_SUN = (-0.45, 0.4, -1.0)
"""Direction of the light. It comes from the side, so that the visible faces of a wall differ in brightness."""
_WALL, _FLOOR = (0.62, 0.68, 0.78), (225, 219)
"""Colour of walls, and grey values of the floor's fields."""
_SHADE = (0.05, 0.07, 0.12, 0.30)
"""Colour and opacity of shadows on the floor."""
_SHADOW = 0.35
"""Length of a shadow as a share of the height of what casts it, at most for `_TALL` [m]."""
_TALL = 0.6
_LIFT = 0.003
"""Height of a shadow [m]. On the floor it would flicker."""
_NEAR = 12.0
"""Distance from the camera's target up to which walls have a shadow [m]."""


class Mark(NamedTuple):
    """A shape that is drawn into the scene, in {W}."""

    kind: Literal["ribbon", "arrow", "disc"]
    """Flat ribbon or arrow from ``a`` to ``b``, or a flat disc at ``a``."""
    a: Numbers | Float[np.ndarray, "3"]
    """First point [m]."""
    b: Numbers | Float[np.ndarray, "3"]
    """Second point [m]. A disc does not use it."""
    radius: float
    """Radius, or half of a ribbon's width [m]."""
    colour: tuple[float, float, float, float]
    """Red, green, blue and opacity, 0 to 1."""


class Shot(NamedTuple):
    """A rendered image and the camera that made it."""

    image: Shaped[np.ndarray, "height width 3"]
    """RGB image, uint8."""
    eye: Float[np.ndarray, "3"]
    """Position of the camera in {W} [m]."""
    axes: Float[np.ndarray, "3 3"]
    """Rows: directions of the image's right and lower edge and of view, the first two per pixel at distance 1."""

    def pixels(self, points: Numbers | Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 2"]:
        """Image coordinates (right, down) of points in {W} [pixels]. NaN for a point behind the camera."""
        right, down, depth = np.moveaxis((np.asarray(points, dtype=float) - self.eye) @ self.axes.T, -1, 0)
        depth = np.where(depth > 0.05, depth, np.nan)
        height, width = self.image.shape[:2]
        return np.stack([width / 2 + right / depth, height / 2 + down / depth], axis=-1)


@cache
def can_render() -> str:
    """Check whether MuJoCo can render on this machine.

    The check runs in a separate process, because a GL library without a display can terminate its process.

    Returns:
        An empty string if rendering works, otherwise the reason.
    """
    if os.environ.get("MUJOCO_GL") == "disable":
        return "MUJOCO_GL is disable, as it is by default where there is neither a display nor EGL"
    done = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=120, check=False)
    if done.returncode == 0:
        return ""
    errors = [line for line in done.stderr.splitlines() if "Error" in line]
    return errors[-1].strip() if errors else f"the renderer ended with code {done.returncode}"


def has_display() -> bool:
    """Whether a window can be opened on this machine."""
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bool(glfw.init())


def frames(
    scene: Scene, qpos: Float[np.ndarray, "T nq"], *, width: int = 640, height: int = 480, distance: float = 3.6
) -> Iterator[Shaped[np.ndarray, "height width 3"]]:
    """Render configurations, seen obliquely from above. See :func:`shots`.

    Yields:
        One uint8 RGB image per configuration.
    """
    for shot in shots(scene, qpos, width=width, height=height, distance=distance):
        yield shot.image


def shots(
    scene: Scene,
    qpos: Float[np.ndarray, "T nq"],
    *,
    width: int = 640,
    height: int = 480,
    distance: float = 3.6,
    follow: float = 0.15,
    marks: Callable[[int, Float[np.ndarray, "2 3"]], Sequence[Mark]] = lambda i, hands: (),
) -> Iterator[Shot]:
    """Render configurations with marks, seen obliquely from above.

    The camera follows the robot's position smoothly. It does not rotate with the robot.

    Args:
        scene: scene to render.
        qpos: configurations, one per image.
        width: image width [pixels].
        height: image height [pixels].
        distance: distance of the camera from the robot [m].
        follow: share of its distance from the robot by which the camera's target moves per image, 0 to 1.
        marks: shapes to draw into image ``i``, given the positions of both hands in {W} [m].

    Yields:
        One image per configuration, with its camera.
    """
    model = _for_the_eye(scene.model)
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.distance, camera.elevation, camera.azimuth = distance, -48.0, 55.0
    look = np.array([*qpos[0, :2], 0.4])
    options = mujoco.MjvOption()
    options.geomgroup[3] = 0
    hands = [model.geom(f"robot/{hand}").id for hand in ("left_hand", "right_hand")]
    with mujoco.Renderer(model, height, width, max_geom=3 * model.ngeom + 4000) as renderer:
        for i, row in enumerate(qpos):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            look[:2] += follow * (row[:2] - look[:2])
            camera.lookat[:] = look
            renderer.update_scene(data, camera, options)
            _draw_shadows(renderer.scene, scene, data, look[:2])
            for mark in marks(i, data.geom_xpos[hands]):
                _draw(renderer.scene, mark)
            _plain(renderer)
            image = renderer.render()
            yield Shot(image, *_camera(renderer.scene, height))


def tops(scene: Scene) -> Float[np.ndarray, "N"]:
    """Height of each object's highest visible point in the initial configuration [m]."""
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos0
    mujoco.mj_kinematics(model, data)
    seen = model.geom_rgba[:, 3] > 0
    high = data.geom_xpos[:, 2] + model.geom_aabb[:, 5]
    roots = [model.body(f"object{i}/object").id for i in range(len(scene.conditions))]
    parts = [seen & (model.body_rootid[model.geom_bodyid] == root) for root in roots]
    # A wheel's box is that of its own frame, and a wheel is never the highest part.
    return np.array([high[part & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)].max(initial=0.3) for part in parts])


def _for_the_eye(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model in which walls stand out from the floor, and solid parts are opaque."""
    shown = copy.copy(model)
    glass = (shown.geom_rgba[:, 3] > 0.0) & (shown.geom_rgba[:, 3] < 1.0)
    shown.geom_rgba[glass, 3] = 1.0
    shown.mat("wall").rgba[:3] = _WALL
    floor = shown.tex("floor")
    size = int(floor.width[0] * floor.height[0] * floor.nchannel[0])
    grey = shown.tex_data[int(floor.adr[0]) : int(floor.adr[0]) + size]
    grey[:] = np.where(grey > grey.mean(), *_FLOOR)
    shown.light("sun").dir[:] = np.array(_SUN) / np.linalg.norm(_SUN)
    shown.light("sun").diffuse[:] = 0.55
    shown.vis.headlight.ambient[:], shown.vis.headlight.diffuse[:] = 0.38, 0.16
    return shown


def _draw_shadows(canvas: mujoco.MjvScene, scene: Scene, data: mujoco.MjData, around: Float[np.ndarray, "2"]) -> None:
    """Dark flat copies on the floor beside robot, objects and walls.

    Shadow maps would make an image take twice as long on a software renderer.
    """
    shift = _SHADOW * np.array(_SUN[:2])
    yaw = scene.wall_yaw
    near = np.abs(scene.walls[:, :2] - around).max(axis=1) - scene.walls[:, 2:].max(axis=1) < _NEAR
    for x, y, *half in scene.walls[near] if len(scene.walls) else ():
        _cast(canvas, (np.array([x, y]), yaw), half, _TALL * shift)
    for condition, adr in zip(scene.conditions, scene.object_qpos, strict=True):
        w, _, _, z = data.qpos[adr + 3 : adr + 7]
        reach = min(condition.size[2], _TALL) * shift
        _cast(canvas, (data.qpos[adr : adr + 2], 2 * np.arctan2(z, w)), condition.half_extents, reach)
    robot = [*(data.qpos[:2] + 0.5 * _TALL * shift), _LIFT]
    _add(canvas, mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.2, 0.001, 0.0], place=robot, turn=np.eye(3), colour=_SHADE)


def _cast(
    canvas: mujoco.MjvScene,
    pose: tuple[Float[np.ndarray, "2"], float],
    half: Sequence[float],
    reach: Float[np.ndarray, "2"],
) -> None:
    """The shadow of a box: the rectangle around its footprint and the footprint moved by ``reach`` [m]."""
    place, turn = pose[0], _about_z(pose[1])
    size = [*(np.asarray(half) + 0.5 * np.abs(turn[:2, :2].T @ reach)), 0.001]
    centre = [*(place + 0.5 * reach), _LIFT]
    _add(canvas, mujoco.mjtGeom.mjGEOM_BOX, size=size, place=centre, turn=turn, colour=_SHADE)


def _draw(canvas: mujoco.MjvScene, mark: Mark) -> None:
    a, b = (np.asarray(end, dtype=float) for end in (mark.a, mark.b))
    if mark.kind == "disc":
        size = [mark.radius, 0.003, 0.0]
        _add(canvas, mujoco.mjtGeom.mjGEOM_CYLINDER, size=size, place=a, turn=np.eye(3), colour=mark.colour)
    elif mark.kind == "ribbon":
        # A box has so few triangles that hundreds of them take no time on a software renderer; a capsule has not.
        length = float(np.hypot(*(b - a)[:2]))
        size, turn = [length / 2 + mark.radius / 2, mark.radius, 0.002], _about_z(float(np.arctan2(*(b - a)[1::-1])))
        _add(canvas, mujoco.mjtGeom.mjGEOM_BOX, size=size, place=(a + b) / 2, turn=turn, colour=mark.colour)
    else:
        kind = mujoco.mjtGeom.mjGEOM_ARROW
        if _add(canvas, kind, size=[mark.radius] * 3, place=a, turn=np.eye(3), colour=mark.colour):
            mujoco.mjv_connector(canvas.geoms[canvas.ngeom - 1], kind, mark.radius, a, b)


def _about_z(yaw: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about z."""
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    return turn


def _add(
    canvas: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    *,
    size: Sequence[float],
    place: Numbers | Float[np.ndarray, "3"],
    turn: Float[np.ndarray, "3 3"],
    colour: Sequence[float],
) -> bool:
    """Adds a shape, or returns False if there is no room for it."""
    if canvas.ngeom >= canvas.maxgeom:
        return False
    arrays = (np.asarray(a, dtype=float).ravel() for a in (size, place, turn))
    mujoco.mjv_initGeom(canvas.geoms[canvas.ngeom], kind, *arrays, np.asarray(colour, dtype=np.float32))
    canvas.geoms[canvas.ngeom].category = mujoco.mjtCatBit.mjCAT_DECOR
    canvas.ngeom += 1
    return True


def _camera(canvas: mujoco.MjvScene, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Position and axes of the camera, as in `Shot`."""
    # MuJoCo has one camera per eye, which differ in position only.
    left, right = canvas.camera
    eye = (np.array(left.pos) + np.array(right.pos)) / 2
    forward, up = np.array(left.forward, dtype=float), np.array(left.up, dtype=float)
    per_pixel = height * left.frustum_near / (left.frustum_top - left.frustum_bottom)
    return eye, np.stack([per_pixel * np.cross(forward, up), -per_pixel * up, forward])


def _plain(renderer: mujoco.Renderer) -> None:
    """Switch off shadow maps and reflections, which render the scene once more, and the sky, which is never in view."""
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_SKYBOX):
        renderer.scene.flags[flag] = 0


def overview(scene: Scene, width: int = 1280, height: int = 720) -> Shaped[np.ndarray, "height width 3"]:
    """Render the whole scene in its initial configuration, seen obliquely from above.

    Args:
        scene: scene to render.
        width: image width [pixels].
        height: image height [pixels].

    Returns:
        RGB image, uint8.
    """
    model = _for_the_eye(scene.model)
    data = mujoco.MjData(model)
    data.qpos[:] = scene.qpos0
    mujoco.mj_forward(model, data)
    # The floor is infinite, so the view is fitted to the bodies and walls.
    places = np.concatenate([data.xpos[model.body_weldid > 0, :2], data.geom_xpos[sorted(scene.wall_geoms), :2]])
    low, high = places.min(axis=0), places.max(axis=0)
    camera, options = mujoco.MjvCamera(), mujoco.MjvOption()
    camera.type, camera.elevation, camera.azimuth = mujoco.mjtCamera.mjCAMERA_FREE, -50.0, 115.0
    camera.lookat[:], camera.distance = [*(low + high) / 2, 0.4], max(3.2, 1.25 * float(np.hypot(*(high - low))))
    options.geomgroup[3] = 0
    with mujoco.Renderer(model, height, width, max_geom=3 * model.ngeom + 1000) as renderer:
        renderer.update_scene(data, camera, options)
        _draw_shadows(renderer.scene, scene, data, camera.lookat[:2])
        _plain(renderer)
        return np.asarray(renderer.render())
