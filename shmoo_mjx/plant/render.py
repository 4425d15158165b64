"""Renders a scene off-screen with MuJoCo's renderer."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from functools import cache

import mujoco
import numpy as np

from shmoo_mjx.arrays import Float, Shaped
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
    """Render configurations, seen obliquely from above.

    The camera follows the robot's position smoothly. It does not rotate with the robot.

    Args:
        scene: scene to render.
        qpos: configurations, one per image.
        width: image width [pixels].
        height: image height [pixels].
        distance: distance of the camera from the robot [m].

    Yields:
        One uint8 RGB image per configuration.
    """
    model = scene.model
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.distance, camera.elevation, camera.azimuth = distance, -48.0, 55.0
    look = np.array([*qpos[0, :2], 0.4])
    options = mujoco.MjvOption()
    options.geomgroup[3] = 0
    with mujoco.Renderer(model, height, width, max_geom=2 * model.ngeom + 1000) as renderer:
        for row in qpos:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            look[:2] += 0.15 * (row[:2] - look[:2])
            camera.lookat[:] = look
            renderer.update_scene(data, camera, options)
            _plain(renderer)
            yield renderer.render()


def _plain(renderer: mujoco.Renderer) -> None:
    """Switch off shadows, which cause speckles, and reflections; each would render the scene once more."""
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
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
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos0
    mujoco.mj_forward(model, data)
    # The floor is infinite, so the view is fitted to the bodies and walls.
    places = np.concatenate([data.xpos[model.body_weldid > 0, :2], data.geom_xpos[sorted(scene.wall_geoms), :2]])
    low, high = places.min(axis=0), places.max(axis=0)
    camera, options = mujoco.MjvCamera(), mujoco.MjvOption()
    camera.type, camera.elevation, camera.azimuth = mujoco.mjtCamera.mjCAMERA_FREE, -50.0, 115.0
    camera.lookat[:], camera.distance = [*(low + high) / 2, 0.4], max(3.2, 1.25 * float(np.hypot(*(high - low))))
    options.geomgroup[3] = 0
    with mujoco.Renderer(model, height, width, max_geom=2 * model.ngeom + 1000) as renderer:
        renderer.update_scene(data, camera, options)
        _plain(renderer)
        return np.asarray(renderer.render())
