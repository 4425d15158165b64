"""The live page's panel: its controls, texts and curves."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
import viser.uplot

from shmoo_mjx.live import overlay, words
from shmoo_mjx.live.session import SceneLoader, Session, object_files, scenes
from shmoo_mjx.planning.scenario import FAMILIES
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.types import DT

SPEEDS = {"0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "as fast as it goes": 0.0}
SETS_GOAL = "sets the goal"
"""Effect of a click on the floor. The alternative puts down the new object."""
_KEPT = 30.0
"""Time span of the curves [s]."""


class Panel:
    """Controls of the page. The page connects their actions; this class holds what they show."""

    def __init__(self, server: viser.ViserServer, session: Session, first_scene: str) -> None:
        self.session, self._first_scene = session, first_scene
        self._shown_goal: tuple[float, float] | None = None
        self._history: list[tuple[float, float, float, float]] = []
        gui = server.gui
        self.state = gui.add_markdown("")
        self.message = gui.add_markdown("")
        self.objects = gui.add_markdown("")
        self.legend = gui.add_html("")
        self._add_curves(gui)
        with gui.add_folder("Run"):
            self.pause: Any = gui.add_checkbox("paused", False)
            self.step = gui.add_button("one sample of 0.1 s")
            self.speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 x")
            self.reset = gui.add_button("begin again")
        with gui.add_folder("Scene", expand_by_default=False):
            self.scene = gui.add_dropdown("scene", tuple(self.scenes()), initial_value=first_scene)
            self.load = gui.add_button("load it")
            self.name = gui.add_text("name", "mine")
            self.save = gui.add_button("save the scene as it is now")
            self.report = gui.add_button("save the run as a report")
        with gui.add_folder("Goal and new objects"):
            self.click = gui.add_dropdown("a click on the floor", (SETS_GOAL, "puts down the new object"))
            self.goal: Any = gui.add_vector2("goal x, y [m]", session.scenario.goal, step=0.05)
            self.go = gui.add_button("go there")
            self.family = gui.add_dropdown("family", FAMILIES)
            self.mass: Any = gui.add_slider("mass [kg]", 1.0, 80.0, 0.5, 8.0)
            self.payload: Any = gui.add_slider("load [kg]", 0.0, 100.0, 1.0, 0.0)
            self.friction: Any = gui.add_slider("friction", 0.1, 1.2, 0.01, 0.4)
            self.braked = gui.add_checkbox("brakes on", False)
            self.where: Any = gui.add_vector3("x, y [m], heading [deg]", (0.0, 0.0, 0.0), step=0.05)
            self.put = gui.add_button("put it there")
        with gui.add_folder("An object that is there"):
            self.which = gui.add_dropdown("object", ("none",))
            heavier: Any = gui.add_slider("load [kg]", 0.0, 100.0, 1.0, 0.0)
            slippery: Any = gui.add_slider("friction", 0.1, 1.2, 0.01, 0.4)
            brakes: Any = gui.add_checkbox("brakes on", False)
            self.present = (heavier, slippery, brakes)
            self.alter = gui.add_button_group("now", ("set load", "set friction", "set brakes"))
            self.drag = gui.add_checkbox("drag objects by handles", False)
        with gui.add_folder("Show", expand_by_default=False):
            names = ("path", "roll-outs", "camera", "what it believes", "clearance")
            self.shown = {name: gui.add_checkbox(name, name != "clearance") for name in names}

    def _add_curves(self, gui: viser.GuiApi) -> None:
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

    def say(self, text: str, refused: bool = False) -> None:
        """Shows the message of a request."""
        if text:
            self.message.content = f"**{'Refused' if refused else 'Done'}.** {text}"

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

    def forget_curves(self) -> None:
        """Clears the curves for a new run."""
        self._history.clear()

    def tell(self) -> None:
        """Updates texts and curves with the session's last sample."""
        session, simulation = self.session, self.session.simulation
        true, p = simulation.true, session.probability
        force = float(np.linalg.norm(true.wrench[0, :, :2].sum(axis=0))) if true.wrench.size else 0.0
        lean = float(np.rad2deg(np.linalg.norm(true.lean[0])))
        if session.scenario.goal != self._shown_goal:
            self._shown_goal = session.scenario.goal
            self.goal.value = (round(self._shown_goal[0], 2), round(self._shown_goal[1], 2))
        self.state.content = words.state_text(session, lean, force)
        if not self._history or simulation.time > self._history[-1][0]:
            self._history.append((simulation.time, lean, force / 10, np.nan if p is None else p))
            self._history = [row for row in self._history if row[0] > simulation.time - _KEPT]
        if round(simulation.time / DT) % 5 == 0:
            self.objects.content = words.beliefs(session)
            t, leans, forces, chances = (np.array(column) for column in zip(*self._history, strict=True))
            self._curves.data, self._chance.data = (t, leans, forces), (t, chances)
            self.legend.content = overlay.legend(session.plan)


def _set(slider: Any, value: float) -> None:
    """Sets the value, extending the slider's range if necessary."""
    slider.min, slider.max = min(slider.min, value), max(slider.max, value)
    slider.value = value
