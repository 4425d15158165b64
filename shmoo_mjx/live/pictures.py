"""The live page's 3-D view: world, handles, lines and distance field, drawn on a viser server.

A separate thread draws frames that interpolate between the last two samples, so the motion is smooth regardless of the
computing time of a sample.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene

from shmoo_mjx.arrays import Array
from shmoo_mjx.geometry import se2
from shmoo_mjx.live import overlay
from shmoo_mjx.live.cameras import Cameras
from shmoo_mjx.live.panel import Panel
from shmoo_mjx.live.session import Session
from shmoo_mjx.planning import flat_trajectory
from shmoo_mjx.types import DT

RATE = 20.0
"""Frames per second."""


class _World(NamedTuple):
    """The world that is drawn."""

    number: int
    """Value of Session.started when it was made."""
    scene: ViserMujocoScene
    model: mujoco.MjModel
    data: mujoco.MjData


class Pictures:
    """Draws the session's world on a server until it is closed.

    Args:
        server: server of the page.
        panel: determines what is shown.
        place: takes the index and the new pose of an object that the user has dragged.
    """

    def __init__(
        self, server: viser.ViserServer, panel: Panel, place: Callable[[int, tuple[float, float, float]], None]
    ) -> None:
        self.server, self.panel, self._place = server, panel, place
        self.speed, self.count = 1.0, 0
        """Speed of the simulation, 0 for as fast as possible; number of frames so far."""
        self._lock, self._closed = threading.RLock(), threading.Event()
        self._world: _World | None = None
        self._samples: tuple[np.ndarray, np.ndarray, float] | None = None
        self.handles: list[Any] = []
        self._dragged: set[int] = set()
        """Objects whose handles the user is dragging."""
        self._clearance: Any = None
        self._cameras = Cameras(server)
        self._thread = threading.Thread(target=self._draw, name="pictures", daemon=True)

    @property
    def session(self) -> Session:
        """The session that is drawn."""
        return self.panel.session

    @property
    def closed(self) -> bool:
        """Whether drawing has ended."""
        return self._closed.is_set()

    def start(self) -> None:
        """Starts drawing."""
        self._thread.start()

    def close(self) -> None:
        """Stops drawing."""
        self._closed.set()
        self._thread.join(timeout=2.0)

    @property
    def outdated(self) -> bool:
        """Whether the session has another world than the one that is drawn."""
        return self._world is None or self._world.number != self.session.started

    def show(self) -> None:
        """Shows the session's last sample: lines at once, the world by interpolation from now on."""
        past, now = self.panel.past, self.session.simulation.qpos
        if past is not None:
            now = self.session.simulation.history.qpos[past]
        with self._lock:
            kept = past is None and self._samples is not None and len(self._samples[1]) == len(now)
            before = self._samples[1] if kept and self._samples is not None else now
            self._samples = (before, now, time.perf_counter())
        self._move_handles()
        self.draw_lines()

    def _move_handles(self) -> None:
        """Moves every handle to its object, except handles that the user is dragging."""
        for index, handle in enumerate(self.handles):
            if index not in self._dragged:
                handle.position, handle.wxyz = _placed(self.session.simulation.true.object_pose[0, index])

    def draw_handles(self) -> None:
        """Draws a handle on every object at its current pose."""
        for handle in self.handles:
            handle.remove()
        self.handles = []
        self._dragged.clear()
        if not self.panel.drag.value:
            return
        for index, pose in enumerate(self.session.simulation.true.object_pose[0]):
            position, wxyz = _placed(pose)
            handle = self.server.scene.add_transform_controls(
                f"/handles/{index}",
                scale=0.7,
                active_axes=(True, True, False),
                position=position,
                wxyz=wxyz,
                depth_test=False,
            )
            handle.on_update(partial(self.dragging, index))
            self.handles.append(handle)

    async def dragging(self, index: int, event: viser.TransformControlsEvent) -> None:
        """Handles the start, motion and end of a drag.

        It runs on the server's event loop, which keeps these phases in order.
        """
        if event.phase != "end":
            self._dragged.add(index)
            return
        handle = event.target
        yaw = 2 * np.arctan2(handle.wxyz[3], handle.wxyz[0])
        place = (float(handle.position[0]), float(handle.position[1]), float(se2.wrap(yaw)))
        self._place(index, place)

    def redraw(self) -> None:
        """Redraws everything, for another world or other objects."""
        session = self.session
        with self._lock, self.server.atomic():
            self.server.scene.reset()
            self._clearance = None
            model = session.simulation.scene.model
            scene = ViserMujocoScene(self.server, model, num_envs=1)
            scene.camera_tracking_enabled = False
            self._lay_floor()
            fresh = self._world is None
            self._world = _World(session.started, scene, model, mujoco.MjData(model))
            now = session.simulation.qpos
            self._samples = (now, now, time.perf_counter())
        self.handles = []
        self.draw_handles()
        self.draw_lines()
        if fresh:
            centre, size = self._extent()
            reach, camera = max(size), self.server.initial_camera
            x = centre[0] + 0.12 * reach  # the panel covers the right side of the view
            camera.position, camera.look_at = (x, centre[1] - 0.5 * reach, 0.75 * reach), (x, centre[1], 0.0)

    def _extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Centre and size of the map in {W} [m]."""
        low_x, low_y, high_x, high_y = self.session.simulation.grid.bounds
        return ((low_x + high_x) / 2, (low_y + high_y) / 2), (high_x - low_x, high_y - low_y)

    def _lay_floor(self) -> None:
        """A pale floor of the map's size with a line per metre, which replaces the infinite floor."""
        for name in ("/fixed_bodies/world/floor", "/fixed_bodies/world/None"):
            if endless := self.server.scene.get_handle_by_name(name):
                endless.visible = False
        centre, size = self._extent()
        self.server.scene.add_grid(
            "/floor", width=size[0], height=size[1], cell_size=1.0, section_size=1.0, cell_color=(225, 226, 230),
            section_color=(225, 226, 230), section_thickness=1.0, position=(*centre, 0.0), plane_color=(250, 250, 248),
            plane_opacity=1.0, shadow_opacity=0.15,
        )  # fmt: skip

    def _draw(self) -> None:
        """Draws frames that interpolate between the last two samples."""
        while not self._closed.wait(1.0 / RATE):
            with self._lock:
                if self._world is None or self._samples is None:
                    continue
                before, now, since = self._samples
                length = DT / self.speed if self.speed else DT / 2
                part = float(np.clip((time.perf_counter() - since) / length, 0.0, 1.0))
                world = self._world
                world.data.qpos[:] = before + part * (now - before)
                mujoco.mj_normalizeQuat(world.model, world.data.qpos)
                mujoco.mj_kinematics(world.model, world.data)
                with self.server.atomic():
                    world.scene.update_from_mjdata(world.data)
                self._cameras.move(self.panel.view.value, world.data)
                self.count += 1

    def draw_lines(self) -> None:
        """Draws paths, roll-outs, the camera's view, believed footprints, the goal and the distance field."""
        session = self.session
        simulation, state = session.simulation, session.simulation.navigator.state
        way, trajectory = state.path, state.drive.trajectory
        if state.segment is not None:
            way = state.segment.way if str(state.mode) == "approach" else None
        local = None
        if trajectory is not None:
            local = flat_trajectory.evaluate(trajectory, np.linspace(0.0, trajectory.horizon, 25)).position
        goal = np.append(state.goal, 0.0)
        top = 0.0 if state.segment is None else simulation.conditions[state.segment.object].size[2]
        sizes = [c.half_extents for c in simulation.conditions]
        drawn = {
            "path": (overlay.path(None if way is None else way.points), 0.03),
            "path/local": (overlay.path(local, local=True), 0.05),
            "roll-outs": (overlay.rollouts(session.plan, top), 0.012),
            "camera": (overlay.field_of_view(session.senses.camera, simulation.true.robot_pose[0]), 0.015),
            "estimated poses": (overlay.believed(simulation.navigator, simulation.observation, sizes), 0.03),
        }
        with self.server.atomic():
            for name, (lines, thickness) in drawn.items():
                # The lines belong to the present.
                wanted = self.panel.past is None and self.panel.shown[name.partition("/")[0]].value
                shown = wanted and len(lines.points) > 0
                self.server.scene.add_line_segments(
                    f"/lines/{name}",
                    lines.points if shown else np.zeros((1, 2, 3)),
                    lines.colours if shown else np.zeros((1, 2, 3), dtype=np.uint8),
                    thickness=thickness,
                    visible=bool(shown),
                )
            self.server.scene.add_icosphere("/lines/goal", 0.12, color=(0, 158, 115), position=tuple(goal))
            self._draw_clearance()

    def _draw_clearance(self) -> None:
        """Draws the distance field on the floor. It is redrawn when the believed pose of an object changes."""
        shown = self.panel.shown["clearance"].value
        field = self.session.simulation.navigator.belief.clearance() if shown else None
        if field is self._clearance:
            return
        self._clearance = field
        if field is None:
            self.server.scene.remove_by_name("/clearance")
            return
        height, width = (n * float(field.resolution) for n in field.values.shape)
        yaw = float(field.origin[2])
        centre = se2.transform_point(np.asarray(field.origin), np.array([width / 2, height / 2]))
        self.server.scene.add_image(
            "/clearance", overlay.clearance_picture(field), width, height, format="png", cast_shadow=False,
            receive_shadow=False, position=(*centre, 0.008), wxyz=(np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)),
        )  # fmt: skip


def _placed(pose: Array) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Position and quaternion of a handle for an object at ``pose [3]``."""
    x, y, half = (float(v) for v in (pose[0], pose[1], pose[2] / 2))
    return (x, y, 0.05), (float(np.cos(half)), 0.0, 0.0, float(np.sin(half)))
