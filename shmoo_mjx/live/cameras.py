"""Cameras of the live page's browsers: free, following the robot, or looking through the robot's camera."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import mujoco
import numpy as np
import viser

FREE, FOLLOW, ROBOT = "free", "follow the robot", "robot's camera"
VIEWS = (FREE, FOLLOW, ROBOT)
"""Names of the views."""
_DISTANCE = 4.0
"""Distance of a following camera from the robot when following begins [m]."""
_SHIFT = 1.5
"""Shift of the view towards the viewer on a narrow window, relative to the horizontal part of the direction [m]."""
_LEAST = 0.004
"""Displacement of the robot from which the following cameras move [m]."""
_HOUSING = 0.06
"""Distance of the drawn view in front of the camera's centre [m], so that the housing does not hide the scene."""
_TILT = float(np.deg2rad(15.0))
"""Downward tilt of the drawn view [rad]. The simulated camera has no limit of its vertical field of view."""
_FIELD = float(np.deg2rad(42.0))
"""Vertical field of view of the robot's camera [rad], that of the D435's colour image."""

# viser warns of messages to a closed browser. One may close between the listing of browsers and the move of its camera,
# which does no harm.
warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)


class _Pose(NamedTuple):
    """Camera of a browser."""

    position: np.ndarray
    look_at: np.ndarray
    fov: float


class Cameras:
    """Moves the cameras of all browsers with the robot.

    Args:
        server: server of the page.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self.server = server
        self._view: dict[int, str] = {}
        """View of each browser by its id."""
        self._free: dict[int, _Pose] = {}
        """Free camera of each browser before it looked through the robot's camera."""
        self._at: dict[int, np.ndarray] = {}
        """Position of the robot that each following camera has followed to."""

    def move(self, view: str, data: mujoco.MjData) -> None:
        """Moves all cameras for one frame with the world in ``data``. ``view`` is one of `VIEWS`."""
        robot = data.body("robot/torso").xpos.copy()
        for number, client in self.server.get_clients().items():
            if self._view.get(number, FREE) != view:
                self._switch(number, client.camera, view, robot)
            moved = (robot - self._at.get(number, robot)) * (1.0, 1.0, 0.0)
            if view == FOLLOW and np.linalg.norm(moved) > _LEAST:
                client.camera.position = client.camera.position + moved
                self._at[number] = robot
            if view == ROBOT:
                _look_ahead(client.camera, data)

    def _switch(self, number: int, camera: viser.CameraHandle, view: str, robot: np.ndarray) -> None:
        """Changes the view of one browser."""
        if number in self._free:
            camera.position, camera.look_at, camera.fov = self._free.pop(number)
        if view == ROBOT:
            self._free[number] = _Pose(camera.position, camera.look_at, camera.fov)
            camera.fov = _FIELD
        if view == FOLLOW:
            towards = camera.position - camera.look_at
            towards = towards / np.linalg.norm(towards)
            # On a phone the panel covers the lower half of the view.
            shift = _SHIFT * towards * (1.0, 1.0, 0.0) if camera.aspect < 1.0 else np.zeros(3)
            camera.position = robot + _DISTANCE * towards + shift
            camera.look_at = robot + shift
            self._at[number] = robot
        self._view[number] = view


def _look_ahead(camera: viser.CameraHandle, data: mujoco.MjData) -> None:
    """Places a browser's camera where the robot's is."""
    geom = data.geom("robot/torso_camera")
    ahead = geom.xmat.reshape(3, 3) @ (np.cos(_TILT), 0.0, -np.sin(_TILT))
    camera.position = geom.xpos + _HOUSING * ahead
    camera.look_at = camera.position + ahead
