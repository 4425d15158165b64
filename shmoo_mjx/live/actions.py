"""User actions of the live page, executed between two samples. Each returns a message about its effect."""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.live.panel import Panel
from shmoo_mjx.live.pictures import Pictures
from shmoo_mjx.live.session import Session, object_files
from shmoo_mjx.live.words import object_index


class Actions:
    """Changes the session and updates the page's panel and pictures."""

    def __init__(self, panel: Panel, pictures: Pictures) -> None:
        self.panel, self.pictures = panel, pictures

    @property
    def session(self) -> Session:
        """The session to change."""
        return self.panel.session

    def reset(self) -> str:
        """Restarts the scene."""
        self.session.reset()
        self.panel.forget_curves()
        return "The scene begins again."

    def load(self, name: str) -> str:
        """Loads another scene."""
        loaders = self.panel.scenes()
        if name not in loaders:
            raise ShmooError(f"There is no scene {name!r} any more.")
        self.session.load(loaders[name])
        self.panel.forget_curves()
        return f"Loaded {name}."

    def save(self, name: str) -> str:
        """Saves the current scene."""
        path = self.session.save_scenario(name)
        self.panel.scene.options = tuple(self.panel.scenes())
        return f"Saved {path}; shmoo navigate --scenario {path}"

    def report(self, name: str) -> str:
        """Saves the run as a report."""
        return f"Saved {self.session.save_report(name)}."

    def head_for(self, x: float, y: float) -> str:
        """Sets another goal in {W} [m]."""
        self.session.head_for(x, y)
        return f"It heads for ({x:.2f}, {y:.2f})."

    def add(self, family: str, pose: tuple[float, float, float], properties: dict[str, float], braked: bool) -> str:
        """Adds a new object at ``pose`` in {W}."""
        session, index = self.session, len(self.session.scenario.objects)
        session.add(str(object_files(session.out).get(family, family)), pose, properties)
        if session.simulation.conditions[index].locked:
            session.brake(index, braked)
        heading = round(float(np.rad2deg(pose[2])), 1)
        self.panel.where.value = (round(pose[0], 2), round(pose[1], 2), heading)
        return f"Object {index}: {session.simulation.conditions[index].describe()}."

    def alter(self, which: str, what: str, value: Any) -> str:
        """Changes the load, friction or brakes of an existing object."""
        index, session = object_index(which), self.session
        if index is None:
            raise ShmooError("There is no object yet; put one down first.")
        if what == "set brakes":
            session.brake(index, bool(value))
        else:
            session.alter(index, **{"set load": {"payload": value}, "set friction": {"friction": value}}[what])
        return f"Object {index}: {session.simulation.conditions[index].describe()}."

    def place(self, index: int, pose: tuple[float, float, float]) -> str:
        """Moves an existing object to ``pose`` in {W}."""
        try:
            self.session.place(index, pose)
        finally:
            self.pictures.draw_handles()
        return f"Object {index} stands at ({pose[0]:.2f}, {pose[1]:.2f})."
