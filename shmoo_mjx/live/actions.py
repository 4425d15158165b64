"""What a person asks for on the live page, carried out between two samples; each action says what it has done."""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.live.panel import Panel
from shmoo_mjx.live.pictures import Pictures
from shmoo_mjx.live.session import Session, object_files
from shmoo_mjx.live.words import object_index


class Actions:
    """Changes of the session, shown on the page's panel and pictures."""

    def __init__(self, panel: Panel, pictures: Pictures) -> None:
        self.panel, self.pictures = panel, pictures

    @property
    def session(self) -> Session:
        """What is changed."""
        return self.panel.session

    def reset(self) -> str:
        """Begin the scene again."""
        self.session.reset()
        self.panel.forget_curves()
        return "The scene begins again."

    def load(self, name: str) -> str:
        """Load another scene."""
        loaders = self.panel.scenes()
        if name not in loaders:
            raise ShmooError(f"There is no scene {name!r} any more.")
        self.session.load(loaders[name])
        self.panel.forget_curves()
        return f"Loaded {name}."

    def save(self, name: str) -> str:
        """Save the scene as it is now."""
        path = self.session.save_scenario(name)
        self.panel.scene.options = tuple(self.panel.scenes())
        return f"Saved {path}; shmoo navigate --scenario {path}"

    def report(self, name: str) -> str:
        """Save the run as a report."""
        return f"Saved {self.session.save_report(name)}."

    def head_for(self, x: float, y: float) -> str:
        """Set another goal in {W} [m]."""
        self.session.head_for(x, y)
        return f"It heads for ({x:.2f}, {y:.2f})."

    def add(self, family: str, pose: tuple[float, float, float], properties: dict[str, float], braked: bool) -> str:
        """Put a new object to ``pose`` in {W}."""
        session, index = self.session, len(self.session.scenario.objects)
        session.add(str(object_files(session.out).get(family, family)), pose, properties)
        if session.simulation.conditions[index].locked:
            session.brake(index, braked)
        heading = round(float(np.rad2deg(pose[2])), 1)
        self.panel.where.value = (round(pose[0], 2), round(pose[1], 2), heading)
        return f"Object {index}: {session.simulation.conditions[index].describe()}."

    def alter(self, which: str, what: str, value: Any) -> str:
        """Change the load, friction or brakes of an object that is there."""
        index, session = object_index(which), self.session
        if index is None:
            raise ShmooError("There is no object yet; put one down first.")
        if what == "set brakes":
            session.brake(index, bool(value))
        else:
            session.alter(index, **{"set load": {"payload": value}, "set friction": {"friction": value}}[what])
        return f"Object {index}: {session.simulation.conditions[index].describe()}."

    def place(self, index: int, pose: tuple[float, float, float]) -> str:
        """Put an object that is there to ``pose`` in {W}."""
        try:
            self.session.place(index, pose)
        finally:
            self.pictures.draw_handles()
        return f"Object {index} stands at ({pose[0]:.2f}, {pose[1]:.2f})."
