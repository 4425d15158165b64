"""The live page: a viser server that draws a :class:`~shmoo_mjx.live.session.Session` and takes what a person wants.

The page's callbacks come in threads of the server. They only put what is wanted into a queue; whoever runs the session
carries it out between two samples (:meth:`Page.carry_out`), so that nothing changes under the simulation's feet.
Pictures are drawn by a thread of their own, between the last two samples, smoothly whatever a sample takes.
"""

from __future__ import annotations

import io
import queue
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import viser
import viser.uplot
from mjviser import ViserMujocoScene
from pydantic import ValidationError

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning import online
from shmoo_mjx.live import overlay
from shmoo_mjx.live.own_page import obeying_own_page
from shmoo_mjx.live.session import SceneLoader, Session, object_files, scenes
from shmoo_mjx.planning import flat_trajectory
from shmoo_mjx.planning.scenario import FAMILIES
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.observe import DIVERGED
from shmoo_mjx.types import DT

PICTURES = 20.0
"""Pictures that are sent each second."""
_SPEEDS = {"0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "as fast as it goes": 0.0}
_GOAL, _NEW = "sets the goal", "puts down the new object"
_KEPT = 30.0
"""Time that the curves show [s]."""


class _World(NamedTuple):
    """What pictures are drawn of."""

    number: int
    """Session.started when it was made."""
    scene: ViserMujocoScene
    model: mujoco.MjModel
    data: mujoco.MjData


class Page:
    """A page in the browser on ``http://host:port``, or the next free port; whoever makes it steps the session.

    ``scene`` is what the session has loaded, as `scene_named` takes it; the page's box of scenes shows it at first.
    """

    def __init__(
        self, session: Session, host: str = "127.0.0.1", port: int = 8080, scene: str = "the first scene"
    ) -> None:
        self.session, self._first_scene = session, scene
        with obeying_own_page(host), redirect_stdout(io.StringIO()):  # its banner
            self.server = viser.ViserServer(host=host, port=port, label="shmoo live", verbose=False)
        self.speed, self.pictures = 1.0, 0
        self._wanted: queue.SimpleQueue[Callable[[], str | None]] = queue.SimpleQueue()
        self._single = False
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._world: _World | None = None
        self._samples: tuple[np.ndarray, np.ndarray, float] | None = None
        self._handles: list[Any] = []
        self._dragged: set[int] = set()
        """Objects whose handles somebody holds."""
        self._told_goal: tuple[float, float] | None = None
        self._history: list[tuple[float, float, float, float]] = []
        self._clearance: Any = None
        # Its button to share a page would hand this one to a server elsewhere.
        self.server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self.server.scene.set_up_direction("+z")
        # Shadows cost a browser that draws in software a third of its pictures.
        self.server.scene.configure_default_lights(cast_shadow=False)
        self._build()
        self._redraw()
        self.server.scene.on_click()(self._clicked)
        self._drawing = threading.Thread(target=self._draw, name="pictures", daemon=True)
        self._drawing.start()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    @property
    def paused(self) -> bool:
        """Whether the world stands still, as the page's box says."""
        return bool(self._pause.value)

    @paused.setter
    def paused(self, stands: bool) -> None:
        self._pause.value = stands

    @property
    def closed(self) -> bool:
        """Whether it has been closed."""
        return self._closed.is_set()

    def close(self) -> None:
        """Stop the server."""
        self._closed.set()
        self._drawing.join(timeout=2.0)
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def carry_out(self) -> bool:
        """Do what was asked for on the page since the last call; whether a sample is due then."""
        any_request = False
        while True:
            try:
                wanted = self._wanted.get_nowait()
            except queue.Empty:
                break
            any_request = True
            self._attempt(wanted)
        due, self._single = not self.paused or self._single, False
        if any_request and not due:
            self.show()
        return due

    def _attempt(self, wanted: Callable[[], str | None]) -> None:
        """Do it, and say how that went; whatever fails, the run goes on."""
        try:
            self._say(wanted() or "")
        except ShmooError as error:
            self._say(str(error), refused=True)
        except (ValidationError, ValueError, OSError) as error:
            self._say(f"That can't be done: {error}", refused=True)
        except Exception as error:
            traceback.print_exc()
            self._say(f"That failed ({type(error).__name__}: {error}).", refused=True)

    def show(self) -> None:
        """Take in the session's last sample: lines, words and curves at once, the world from now on."""
        session = self.session
        if self.closed:
            return
        if self._world is None or self._world.number != session.started:
            self._redraw()
        now = session.simulation.qpos
        with self._lock:
            before = now if self._samples is None or len(self._samples[1]) != len(now) else self._samples[1]
            self._samples = (before, now, time.perf_counter())
        self._move_handles()
        self._draw_lines()
        self._tell()

    def _ask(self, wanted: Callable[[], str | None]) -> None:
        self._wanted.put(wanted)

    def _say(self, text: str, refused: bool = False) -> None:
        if text:
            self._message.content = f"**{'Refused' if refused else 'Done'}.** {text}"

    # The panel.

    def _build(self) -> None:
        gui = self.server.gui
        self._state = gui.add_markdown("")
        self._message = gui.add_markdown("")
        self._objects = gui.add_markdown("")
        self._legend = gui.add_html("")
        empty = np.zeros(1)
        curves = (
            viser.uplot.Series(label="t [s]"),
            viser.uplot.Series(label="lean [deg]", stroke="#0072B2", width=2),
            viser.uplot.Series(label="force [N / 10]", stroke="#D55E00", width=2),
        )
        self._curves = gui.add_uplot((empty, empty, empty), curves, aspect=2.2, scales={"x": {"time": False}})
        chance = (curves[0], viser.uplot.Series(label="P(push frees the path)", stroke="#009E73", width=2))
        scales: dict[str, Any] = {"x": {"time": False}, "y": {"auto": False, "range": (-0.05, 1.05)}}
        self._chance = gui.add_uplot((empty, empty), chance, aspect=3.2, scales=scales)
        with gui.add_folder("Run"):
            self._pause: Any = gui.add_checkbox("paused", False)
            step = gui.add_button("one sample of 0.1 s")
            speed = gui.add_dropdown("speed", tuple(_SPEEDS), initial_value="1 x")
            reset = gui.add_button("begin again")
        with gui.add_folder("Scene", expand_by_default=False):
            self._scene = gui.add_dropdown("scene", tuple(self._scenes()), initial_value=self._first_scene)
            load = gui.add_button("load it")
            name = gui.add_text("name", "mine")
            save = gui.add_button("save the scene as it is now")
            report = gui.add_button("save the run as a report")
        with gui.add_folder("Goal and new objects"):
            self._click = gui.add_dropdown("a click on the floor", (_GOAL, _NEW))
            self._goal: Any = gui.add_vector2("goal x, y [m]", self.session.scenario.goal, step=0.05)
            go = gui.add_button("go there")
            self._family = gui.add_dropdown("family", FAMILIES)
            mass: Any = gui.add_slider("mass [kg]", 1.0, 80.0, 0.5, 8.0)
            load_mass: Any = gui.add_slider("load [kg]", 0.0, 100.0, 1.0, 0.0)
            friction: Any = gui.add_slider("friction", 0.1, 1.2, 0.01, 0.4)
            braked = gui.add_checkbox("brakes on", False)
            self._where: Any = gui.add_vector3("x, y [m], heading [deg]", (0.0, 0.0, 0.0), step=0.05)
            put = gui.add_button("put it there")
        with gui.add_folder("An object that is there"):
            self._which = gui.add_dropdown("object", ("none",))
            heavier: Any = gui.add_slider("load [kg]", 0.0, 100.0, 1.0, 0.0)
            slippery: Any = gui.add_slider("friction", 0.1, 1.2, 0.01, 0.4)
            brakes: Any = gui.add_checkbox("brakes on", False)
            self._present = (heavier, slippery, brakes)
            alter = gui.add_button_group("now", ("set load", "set friction", "set brakes"))
            self._drag = gui.add_checkbox("drag objects by handles", False)
        with gui.add_folder("Show", expand_by_default=False):
            names = ("path", "roll-outs", "camera", "what it believes", "clearance")
            self._shown = {name: gui.add_checkbox(name, name != "clearance") for name in names}
        step.on_click(lambda _: self._ask(self._one_sample))
        speed.on_update(lambda _: setattr(self, "speed", _SPEEDS[speed.value]))
        reset.on_click(lambda _: self._ask(self._reset))
        load.on_click(lambda _: self._ask(partial(self._load, self._scene.value)))
        save.on_click(lambda _: self._ask(partial(self._save, name.value)))
        report.on_click(lambda _: self._ask(partial(self._report, name.value)))
        go.on_click(lambda _: self._ask(partial(self._head_for, *self._goal.value)))

        def own_object() -> None:
            # An object of one's own has a mass and friction already.
            if path := object_files(self.session.out).get(self._family.value):
                condition = draw_condition(str(path), 0)
                _set(mass, condition.mass)
                _set(load_mass, 0.0)
                _set(friction, condition.friction)

        self._family.on_update(lambda _: self._attempt(own_object))
        self._which.on_update(lambda _: self._ask(self._show_chosen))

        def new(x: float, y: float) -> Callable[[], str]:
            properties = {"mass": mass.value, "payload": load_mass.value, "friction": friction.value}
            pose = (float(x), float(y), float(np.deg2rad(self._where.value[2])))
            return partial(self._add, self._family.value, pose, properties, braked.value)

        def change(_: Any) -> None:
            values = {"set load": heavier.value, "set friction": slippery.value, "set brakes": brakes.value}
            self._ask(partial(self._alter, self._which.value, alter.value, values[alter.value]))

        self._new = new
        put.on_click(lambda _: self._ask(new(*self._where.value[:2])))
        alter.on_click(change)
        self._drag.on_update(lambda _: self._ask(self._handles_anew))
        for box in self._shown.values():
            box.on_update(lambda _: self._ask(self._draw_lines))
        self.server.on_client_connect(lambda _: self._ask(self._look_for_files))
        # Whoever leaves lets go.
        self.server.on_client_disconnect(lambda _: self._ask(self._handles_anew))

    def _look_for_files(self) -> None:
        """What has been made meanwhile is there to choose when the page is loaded anew."""
        for menu, names in (
            (self._scene, self._scenes()),
            (self._family, [*FAMILIES, *object_files(self.session.out)]),
        ):
            if menu.options != tuple(names):
                menu.options = tuple(names)

    def _scenes(self) -> dict[str, SceneLoader]:
        """What can be loaded, first of all what the page began with."""
        loaders = scenes(self.session.out)
        return loaders if self._first_scene in loaders else {self._first_scene: self.session.first, **loaders}

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        start, along = np.asarray(event.ray_origin), np.asarray(event.ray_direction)
        if abs(along[2]) < 1e-6 or -start[2] / along[2] <= 0:
            return
        x, y = (start - start[2] / along[2] * along)[:2].tolist()
        self._ask(partial(self._head_for, x, y) if self._click.value == _GOAL else self._new(x, y))

    # What is asked for, carried out between samples.

    def _one_sample(self) -> None:
        self._single = True

    def _reset(self) -> str:
        self.session.reset()
        self._history.clear()
        return "The scene begins again."

    def _load(self, name: str) -> str:
        loaders = self._scenes()
        if name not in loaders:
            raise ShmooError(f"There is no scene {name!r} any more.")
        self.session.load(loaders[name])
        self._history.clear()
        return f"Loaded {name}."

    def _save(self, name: str) -> str:
        path = self.session.save_scenario(name)
        self._scene.options = tuple(self._scenes())
        return f"Saved {path}; shmoo navigate --scenario {path}"

    def _report(self, name: str) -> str:
        return f"Saved {self.session.save_report(name)}."

    def _head_for(self, x: float, y: float) -> str:
        self.session.head_for(x, y)
        return f"It heads for ({x:.2f}, {y:.2f})."

    def _add(self, family: str, pose: tuple[float, float, float], properties: dict[str, float], braked: bool) -> str:
        session, index = self.session, len(self.session.scenario.objects)
        session.add(str(object_files(session.out).get(family, family)), pose, properties)
        if session.simulation.conditions[index].locked:
            session.brake(index, braked)
        self._where.value = (round(pose[0], 2), round(pose[1], 2), round(float(np.rad2deg(pose[2])), 1))
        return f"Object {index}: {session.simulation.conditions[index].describe()}."

    def _alter(self, which: str, what: str, value: Any) -> str:
        index, session = _index(which), self.session
        if index is None:
            raise ShmooError("There is no object yet; put one down first.")
        if what == "set brakes":
            session.brake(index, bool(value))
        else:
            session.alter(index, **{"set load": {"payload": value}, "set friction": {"friction": value}}[what])
        return f"Object {index}: {session.simulation.conditions[index].describe()}."

    def _place(self, index: int, pose: tuple[float, float, float]) -> str:
        try:
            self.session.place(index, pose)
        finally:
            self._handles_anew()
        return f"Object {index} stands at ({pose[0]:.2f}, {pose[1]:.2f})."

    def _show_chosen(self) -> None:
        """The controls of an object that is there show what it is."""
        index, (heavier, slippery, brakes) = _index(self._which.value), self._present
        if index is not None and index < len(self.session.simulation.conditions):
            condition = self.session.simulation.conditions[index]
            _set(heavier, condition.payload)
            _set(slippery, condition.friction)
            brakes.value = any(condition.locked)

    def _move_handles(self) -> None:
        """Every handle goes with its object, but for one that somebody holds."""
        for index, handle in enumerate(self._handles):
            if index not in self._dragged:
                handle.position, handle.wxyz = _placed(self.session.simulation.true.object_pose[0, index])

    def _handles_anew(self) -> None:
        """A handle on every object, where it stands now."""
        for handle in self._handles:
            handle.remove()
        self._handles = []
        self._dragged.clear()
        if not self._drag.value:
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
            handle.on_update(partial(self._dragging, index))
            self._handles.append(handle)

    async def _dragging(self, index: int, event: viser.TransformControlsEvent) -> None:
        """A handle is taken, moved or let go. On the server's loop, as only there the phases come in their order."""
        if event.phase != "end":
            self._dragged.add(index)
            return
        handle = event.target
        yaw = 2 * np.arctan2(handle.wxyz[3], handle.wxyz[0])
        place = (float(handle.position[0]), float(handle.position[1]), float(se2.wrap(yaw)))
        self._ask(partial(self._place, index, place))

    # Pictures.

    def _redraw(self) -> None:
        """Another world, or the same with other objects: all of it is drawn anew."""
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
        self._handles = []
        names = (_name(i, c) for i, c in enumerate(session.simulation.conditions))
        self._which.options = tuple(names) or ("none",)
        self._show_chosen()
        self._handles_anew()
        self._draw_lines()
        self._tell()
        if fresh:
            centre, size = self._extent()
            reach, camera = max(size), self.server.initial_camera
            x = centre[0] + 0.12 * reach  # to the right of the map's middle stands the panel
            camera.position, camera.look_at = (x, centre[1] - 0.5 * reach, 0.75 * reach), (x, centre[1], 0.0)

    def _extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Centre and size of the map in {W} [m]."""
        low_x, low_y, high_x, high_y = self.session.simulation.grid.bounds
        return ((low_x + high_x) / 2, (low_y + high_y) / 2), (high_x - low_x, high_y - low_y)

    def _lay_floor(self) -> None:
        """A pale floor as large as the map, with a line each metre, in the place of an endless one."""
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
        """Pictures between the last two samples."""
        while not self._closed.wait(1.0 / PICTURES):
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
                self.pictures += 1

    def _draw_lines(self) -> None:
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
            "what it believes": (overlay.believed(simulation.navigator, simulation.observation, sizes), 0.03),
        }
        with self.server.atomic():
            for name, (lines, thickness) in drawn.items():
                shown = self._shown[name.partition("/")[0]].value and len(lines.points) > 0
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
        """The distance field as a picture on the floor, anew when an object is taken to be elsewhere."""
        shown = self._shown["clearance"].value
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

    # Words.

    def _tell(self) -> None:
        session = self.session
        simulation, navigator = session.simulation, session.simulation.navigator
        true, force = simulation.true, 0.0
        if true.wrench.size:
            force = float(np.linalg.norm(true.wrench[0, :, :2].sum(axis=0)))
        lean = float(np.rad2deg(np.linalg.norm(true.lean[0])))
        reason = navigator.transitions[-1].reason if navigator.transitions else "it looks for a way"
        state = f"{navigator.mode}"
        if simulation.history.ended:
            state, reason = "stopped; begin again", DIVERGED if simulation.history.diverged else "it has fallen"
        if session.scenario.goal != self._told_goal:
            self._told_goal = session.scenario.goal
            self._goal.value = (round(self._told_goal[0], 2), round(self._told_goal[1], 2))
        p = session.probability
        chance = "" if p is None else f", P(push frees the path) **{p:.2f}**"
        spent = 1e3 * np.array(session.spent or [0.0])
        self._state.content = (
            f"### {state}\n{reason}\n\n"
            f"{simulation.time:.1f} s, lean {lean:.1f}°, force {force:.0f} N, senses {session.senses.name}{chance}\n\n"
            f"control step: median {np.median(spent):.0f} ms, worst {spent.max():.0f} ms of the last {len(spent)}; "
            f"{session.late} longer than {1e3 * DT:.0f} ms"
        )
        if not self._history or simulation.time > self._history[-1][0]:
            self._history.append((simulation.time, lean, force / 10, np.nan if p is None else p))
            self._history = [row for row in self._history if row[0] > simulation.time - _KEPT]
        if round(simulation.time / DT) % 5 == 0:
            self._objects.content = self._beliefs()
            t, leans, forces, chances = (np.array(column) for column in zip(*self._history, strict=True))
            self._curves.data, self._chance.data = (t, leans, forces), (t, chances)
            self._legend.content = overlay.legend(session.plan)

    def _beliefs(self) -> str:
        """What the robot thinks of each object, as a Markdown list: a table would be too wide for a phone."""
        navigator, lines = self.session.simulation.navigator, list[str]()
        for index, condition in enumerate(self.session.simulation.conditions):
            name, item = _name(index, condition), navigator.belief.objects.get(index)
            if item is None:
                lines.append(f"- **{name}** not seen yet")
                continue
            verdicts = [d for d in navigator.decisions if d.object == index]
            last = verdicts[-1].reason if verdicts else "not touched"
            moves = {None: "not known", True: "can be moved", False: "can't be moved"}[item.manipulable]
            parts = [f"{item.status}: {moves} ({last})"]
            if item.adapt is not None:
                parts.append(_in_words(online.learned(item.adapt), self.session.prior))
            lines.append(f"- **{name}** {'; '.join(parts)}")
        return "\n".join(lines)


def _name(index: int, condition: Condition) -> str:
    return f"{index} {Path(condition.family).stem}"


def _index(name: str) -> int | None:
    """The number that an object's name begins with; None for "none"."""
    number = name.partition(" ")[0]
    return int(number) if number.isdigit() else None


def _set(slider: Any, value: float) -> None:
    """The value, also where the slider's usual range ends before it."""
    slider.min, slider.max = min(slider.min, value), max(slider.max, value)
    slider.value = value


def _placed(pose: np.ndarray) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Position and quaternion of a handle on an object at ``pose [3]``."""
    x, y, half = (float(v) for v in (pose[0], pose[1], pose[2] / 2))
    return (x, y, 0.05), (float(np.cos(half)), 0.0, 0.0, float(np.sin(half)))


def _in_words(learned: dict[str, float], prior: dict[str, float]) -> str:
    """What was learned of an object against what it was taken to be at first, as far as it is told in a few words."""
    if "mass" not in learned:
        return "coefficients"
    units = {"friction_x": "N along", "friction_y": "N across", "mass": "kg"}
    parts = (f"{_band(learned, name)} {unit} (at first {_band(prior, name)})" for name, unit in units.items())
    return "friction {}, {}, mass {}".format(*parts)


def _band(learned: dict[str, float], name: str) -> str:
    """Median and 80 % band of one quantity."""
    low, middle, high = (learned[f"{name}{end}"] for end in ("_low", "", "_high"))
    return f"{middle:.0f} [{low:.0f} to {high:.0f}]"
