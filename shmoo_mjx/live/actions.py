"""User actions of the live page, executed between two samples. Each returns a message about its effect."""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.live.panel import SHOVES, Panel
from shmoo_mjx.live.pictures import Pictures
from shmoo_mjx.live.scenes import object_files
from shmoo_mjx.live.session import Session
from shmoo_mjx.live.words import object_index, object_name


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
        self.panel.curves.forget()
        return "The scene was restarted."

    def load(self, name: str) -> str:
        """Loads another scene."""
        loaders = self.panel.scenes()
        if name not in loaders:
            raise ShmooError(f"There is no scene {name!r} any more.")
        self.session.load(loaders[name])
        self.panel.curves.forget()
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
        return f"The goal is ({x:.2f}, {y:.2f}) m."

    def add(self, family: str, pose: tuple[float, float, float], properties: dict[str, float], braked: bool) -> str:
        """Adds a new object at ``pose`` in {W}."""
        session, index = self.session, len(self.session.scenario.objects)
        session.add(str(object_files(session.out).get(family, family)), pose, properties)
        if session.simulation.conditions[index].locked:
            session.brake(index, braked)
        heading = round(float(np.rad2deg(pose[2])), 1)
        self.panel.where.value = (round(pose[0], 2), round(pose[1], 2), heading)
        return self._described(index)

    def alter(self, which: str, what: str, value: Any) -> str:
        """Changes the load, friction or brakes of an existing object."""
        index, session = self._index(which), self.session
        if what == "set brakes":
            session.brake(index, bool(value))
        else:
            session.alter(index, **{"set load": {"payload": value}, "set friction": {"friction": value}}[what])
        return self._described(index)

    def shove(self, which: str, direction: str, impulse: float) -> str:
        """Pushes an existing object by hand with an impulse [N s]."""
        index = self._index(which)
        self.session.shove(index, impulse, SHOVES[direction])
        return f"Shoved {which} with {impulse:g} N s."

    def place(self, index: int, pose: tuple[float, float, float]) -> str:
        """Moves an existing object to ``pose`` in {W}."""
        try:
            self.session.place(index, pose)
        finally:
            self.pictures.draw_handles()
        name = object_name(index, self.session.simulation.conditions[index])
        return f"Moved {name} to ({pose[0]:.2f}, {pose[1]:.2f}) m."

    def _index(self, which: str) -> int:
        """Index of the object with this name in the menu."""
        index = object_index(which)
        if index is None:
            raise ShmooError("There is no object; add one first.")
        return index

    def _described(self, index: int) -> str:
        condition = self.session.simulation.conditions[index]
        return f"{object_name(index, condition)}: {condition.describe()}."
