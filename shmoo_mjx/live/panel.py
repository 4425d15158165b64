"""The live page's panel: its controls, texts and curves."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from shmoo_mjx.live import overlay, words
from shmoo_mjx.live.cameras import VIEWS
from shmoo_mjx.live.curves import Curves
from shmoo_mjx.live.scenes import SceneLoader, object_files, scenes
from shmoo_mjx.live.session import Session
from shmoo_mjx.live.tuning import Tuning
from shmoo_mjx.planning.scenario import FAMILIES
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.types import DT

SPEEDS = {"0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "as fast as possible": 0.0}
SETS_GOAL = "sets the goal"
"""Effect of a click on the floor. The alternative adds an object."""
SHOVES = {"away": 0.0, "left": 0.5 * np.pi, "right": -0.5 * np.pi, "towards": np.pi}
"""Directions of a shove as the robot sees the object [rad]."""
_BACK = 30.0
"""How far one can look back [s]."""


class Panel:
    """Controls of the page. The page connects their actions; this class holds what they show."""

    def __init__(self, server: viser.ViserServer, session: Session, first_scene: str) -> None:
        self.session, self._first_scene = session, first_scene
        self.tuning = Tuning(session)
        self._shown_goal: tuple[float, float] | None = None
        gui = server.gui
        self.state = gui.add_markdown("")
        self.message = gui.add_markdown("", visible=False)
        tabs = gui.add_tab_group()
        for name, fill in (
            ("Run", self._add_run),
            ("World", self._add_world),
            ("MPPI", self._add_mppi),
            ("View", self._add_view),
            ("Files", self._add_files),
        ):
            with tabs.add_tab(name):
                fill(gui)
        self.objects = gui.add_markdown("")
        self.curves = Curves(gui)
        self.numbers = gui.add_markdown("")
        self.legend = gui.add_html("")

    def _add_run(self, gui: viser.GuiApi) -> None:
        self.pause: Any = gui.add_checkbox("paused", False)
        self.speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 x")
        self.step = gui.add_button("advance 0.1 s")
        self.reset = gui.add_button("restart")
        hint = "Pauses, and shows the world as it was."
        self.back: Any = gui.add_slider("look back [s]", 0.0, _BACK, DT, 0.0, hint=hint)

    def _add_world(self, gui: viser.GuiApi) -> None:
        self.click = gui.add_dropdown("a click on the floor", (SETS_GOAL, "adds an object"))
        self.goal: Any = gui.add_vector2("goal x, y [m]", self.session.scenario.goal, step=0.05)
        self.go = gui.add_button("go there")
        with gui.add_folder("Change an object"):
            self.which = gui.add_dropdown("object", ("none",))
            hint = "Pushes the object by hand, in the direction that the robot sees."
            self.impulse: Any = gui.add_slider("impulse [N s]", 1.0, 60.0, 1.0, 15.0, hint=hint)
            self.shove = gui.add_button_group("shove", tuple(SHOVES))
            heavier: Any = gui.add_slider("load [kg]", 0.0, 100.0, 1.0, 0.0)
            slippery: Any = gui.add_slider("friction", 0.1, 1.2, 0.01, 0.4)
            brakes: Any = gui.add_checkbox("brakes on", False)
            self.present = (heavier, slippery, brakes)
            self.alter = gui.add_button_group("now", ("set load", "set friction", "set brakes"))
            self.drag = gui.add_checkbox("drag objects by handles", False)
        with gui.add_folder("Add an object", expand_by_default=False):
            self.family = gui.add_dropdown("family", FAMILIES)
            self.mass: Any = gui.add_slider("mass [kg]", 1.0, 80.0, 0.5, 8.0)
            self.payload: Any = gui.add_slider("load [kg]", 0.0, 100.0, 1.0, 0.0)
            self.friction: Any = gui.add_slider("friction", 0.1, 1.2, 0.01, 0.4)
            self.braked = gui.add_checkbox("brakes on", False)
            self.where: Any = gui.add_vector3("x, y [m], heading [deg]", (0.0, 0.0, 0.0), step=0.05)
            self.put = gui.add_button("put it there")

    def _add_mppi(self, gui: viser.GuiApi) -> None:
        control = self.session.controller.config.control
        self.compiling = gui.add_markdown("")
        self.control: dict[str, Any] = {
            "num_rollouts": gui.add_slider("roll-outs", 50, 1000, 50, _within(control.num_rollouts, 50, 1000)),
            "horizon": gui.add_slider("horizon [0.1 s]", 5, 50, 1, _within(control.horizon, 5, 50)),
            "temperature": gui.add_slider("temperature", 0.05, 5.0, 0.05, _within(control.temperature, 0.05, 5.0)),
        }

    def _add_view(self, gui: viser.GuiApi) -> None:
        self.view: Any = gui.add_dropdown("camera", VIEWS)
        names = ("path", "roll-outs", "camera", "estimated poses", "clearance")
        labels = {"camera": "field of view", "clearance": "distance to obstacles"}
        self.shown = {name: gui.add_checkbox(labels.get(name, name), name != "clearance") for name in names}

    def _add_files(self, gui: viser.GuiApi) -> None:
        self.scene = gui.add_dropdown("scene", tuple(self.scenes()), initial_value=self._first_scene)
        self.load = gui.add_button("load")
        self.name = gui.add_text("name", "mine")
        self.save = gui.add_button("save the scene as it is now")
        self.report = gui.add_button("save the run as a report")

    def say(self, text: str, refused: bool = False) -> None:
        """Shows the message of a request."""
        if text:
            self.message.content = f"**Not possible.** {text}" if refused else f"*{text}*"
            self.message.visible = True

    @property
    def past(self) -> int | None:
        """Row of the history that is shown instead of the present; None for the present."""
        rows, samples = len(self.session.simulation.history.rows), round(self.back.value / DT)
        return max(rows - samples, 0) if samples and rows else None

    def scenes(self) -> dict[str, SceneLoader]:
        """Loaders of all available scenes, including the page's first scene."""
        loaders = scenes(self.session.out)
        return loaders if self._first_scene in loaders else {self._first_scene: self.session.first, **loaders}

    def look_for_files(self) -> None:
        """Updates the menus with new files when the page is reloaded."""
        for menu, names in ((self.scene, self.scenes()), (self.family, [*FAMILIES, *object_files(self.session.out)])):
            if menu.options != tuple(names):
                menu.options = tuple(names)

    def show_own_object(self) -> None:
        """Sets mass and friction from a user's own object file."""
        if path := object_files(self.session.out).get(self.family.value):
            condition = draw_condition(str(path), 0)
            _set(self.mass, condition.mass)
            _set(self.payload, 0.0)
            _set(self.friction, condition.friction)

    def list_objects(self) -> None:
        """Updates the menu of existing objects."""
        names = (words.object_name(i, c) for i, c in enumerate(self.session.simulation.conditions))
        self.which.options = tuple(names) or ("none",)
        self.show_chosen()

    def show_chosen(self) -> None:
        """Shows the properties of the chosen object in its controls."""
        index, (heavier, slippery, brakes) = words.object_index(self.which.value), self.present
        if index is not None and index < len(self.session.simulation.conditions):
            condition = self.session.simulation.conditions[index]
            _set(heavier, condition.payload)
            _set(slippery, condition.friction)
            brakes.value = any(condition.locked)

    def tell(self) -> None:
        """Updates texts and curves with the session's last sample."""
        session, past = self.session, self.past
        if session.scenario.goal != self._shown_goal:
            self._shown_goal = session.scenario.goal
            self.goal.value = (round(self._shown_goal[0], 2), round(self._shown_goal[1], 2))
        self.curves.note(session)
        self.tell_compiling()
        if past is not None:
            self.state.content = words.past_text(session, past)
            return
        self.state.content = words.state_text(session)
        self.numbers.content = words.numbers_text(session)
        if round(session.simulation.time / DT) % 5 == 0:
            self.objects.content = words.beliefs(session)
            self.curves.draw(session)
            self.legend.content = overlay.legend(session.plan)

    def tell_compiling(self) -> None:
        """Says whether a controller is being compiled."""
        control, tuning = self.session.controller.config.control, self.tuning
        if tuning.pending:
            text = "**Compiling** the new settings, which takes several seconds. Until then the robot"
        else:
            text = "The robot"
        text += f" plans with {control.num_rollouts} roll-outs of {control.horizon} samples of 0.1 s, temperature "
        text += f"{control.temperature:g}."
        if self.compiling.content != text:
            self.compiling.content = text


def _within(value: float, low: float, high: float) -> Any:
    """The initial value of a slider; a value outside its range is shown at the end."""
    return type(value)(min(max(value, low), high))


def _set(slider: Any, value: float) -> None:
    """Sets the value, extending the slider's range if necessary."""
    slider.min, slider.max = min(slider.min, value), max(slider.max, value)
    slider.value = value
