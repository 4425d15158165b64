"""The live page: a viser server that shows a :class:`~shmoo_mjx.live.session.Session` and handles user input.

The page's callbacks run in threads of the server. They only put requests into a queue. The owner of the session
executes them between two samples (:meth:`Page.carry_out`), so that nothing changes during a step.
"""

from __future__ import annotations

import io
import queue
import traceback
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from typing import Any

import numpy as np
import viser
from pydantic import ValidationError

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.live.actions import Actions
from shmoo_mjx.live.own_page import obeying_own_page
from shmoo_mjx.live.panel import SETS_GOAL, SPEEDS, Panel
from shmoo_mjx.live.pictures import Pictures
from shmoo_mjx.live.session import Session


class Page:
    """A browser page on ``http://host:port``, or the next free port. The caller steps the session.

    ``scene`` is the name of the loaded scene for `scene_named`. It is the initial value of the page's scene menu.
    """

    def __init__(
        self, session: Session, host: str = "127.0.0.1", port: int = 8080, scene: str = "the first scene"
    ) -> None:
        self.session = session
        with obeying_own_page(host), redirect_stdout(io.StringIO()):  # hides its banner
            self.server = viser.ViserServer(host=host, port=port, label="shmoo live", verbose=False)
        self._requests: queue.SimpleQueue[Callable[[], str | None]] = queue.SimpleQueue()
        self._single = False
        # viser's share button would expose this page through an external server.
        self.server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self.server.scene.set_up_direction("+z")
        # Shadows cost a third of the frame rate in a browser with software rendering.
        self.server.scene.configure_default_lights(cast_shadow=False)
        self.panel = Panel(self.server, session, scene)
        self.pictures = Pictures(
            self.server, self.panel, lambda index, pose: self.ask(partial(self.actions.place, index, pose))
        )
        self.actions = Actions(self.panel, self.pictures)
        self._connect()
        self._redraw()
        self.pictures.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    @property
    def speed(self) -> float:
        """Simulated seconds per second; 0 for as fast as possible."""
        return self.pictures.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self.pictures.speed = speed

    @property
    def paused(self) -> bool:
        """Whether the simulation is paused."""
        return bool(self.panel.pause.value)

    @paused.setter
    def paused(self, stands: bool) -> None:
        self.panel.pause.value = stands

    @property
    def closed(self) -> bool:
        """Whether the page has been closed."""
        return self.pictures.closed

    def close(self) -> None:
        """Stops the server."""
        self.pictures.close()
        self.panel.tuning.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def ask(self, request: Callable[[], str | None]) -> None:
        """Queues ``request`` for execution between two samples. It returns a message about its effect, or None."""
        self._requests.put(request)

    def carry_out(self) -> bool:
        """Executes the requests since the last call. Returns whether a sample is due."""
        any_request = False
        while True:
            try:
                request = self._requests.get_nowait()
            except queue.Empty:
                break
            any_request = True
            self._attempt(request)
        self._attempt(self.panel.tuning.advance)
        due, self._single = not self.paused or self._single, False
        if any_request and not due:
            self.show()
        elif not due:
            self.panel.tell_compiling()
        return due

    def _attempt(self, request: Callable[[], str | None]) -> None:
        """Executes a request and shows its message. The run continues after any error."""
        say = self.panel.say
        try:
            say(request() or "")
        except ShmooError as error:
            say(str(error), refused=True)
        except (ValidationError, ValueError, OSError) as error:
            say(str(error), refused=True)
        except Exception as error:
            traceback.print_exc()
            say(f"The request failed ({type(error).__name__}: {error}).", refused=True)

    def show(self) -> None:
        """Shows the session's last sample: lines, texts and curves at once, the world by interpolation from now on."""
        if self.closed:
            return
        if self.pictures.outdated:
            self._redraw()
        self.pictures.show()
        self.panel.tell()

    def one_sample(self) -> None:
        """Requests one sample while the simulation is paused."""
        self.panel.back.value = 0.0
        self._single = True

    def look_back(self) -> None:
        """Pauses while the world is shown as it was."""
        if self.panel.back.value:
            self.paused = True

    def tune(self) -> None:
        """Requests the settings of MPPI that the sliders show."""
        self.panel.tuning.want({name: slider.value for name, slider in self.panel.control.items()})

    def new_object(self, x: float, y: float) -> Callable[[], str]:
        """A request that adds the object described by the panel at (x, y) in {W} [m]."""
        panel = self.panel
        properties = {"mass": panel.mass.value, "payload": panel.payload.value, "friction": panel.friction.value}
        pose = (float(x), float(y), float(np.deg2rad(panel.where.value[2])))
        return partial(self.actions.add, panel.family.value, pose, properties, panel.braked.value)

    def clicked(self, event: viser.SceneClickEvent) -> None:
        """Handles a click on the floor."""
        start, along = np.asarray(event.ray_origin), np.asarray(event.ray_direction)
        if abs(along[2]) < 1e-6 or -start[2] / along[2] <= 0:
            return
        x, y = (start - start[2] / along[2] * along)[:2].tolist()
        goal = self.panel.click.value == SETS_GOAL
        self.ask(partial(self.actions.head_for, x, y) if goal else self.new_object(x, y))

    def _redraw(self) -> None:
        """Redraws everything, for another world or other objects."""
        self.pictures.redraw()
        self.panel.list_objects()
        self.panel.tell()

    def _connect(self) -> None:
        panel, actions, ask = self.panel, self.actions, self.ask
        panel.pause.on_update(lambda _: None if panel.pause.value else setattr(panel.back, "value", 0.0))
        panel.back.on_update(lambda _: ask(self.look_back))
        panel.step.on_click(lambda _: ask(self.one_sample))
        panel.speed.on_update(lambda _: setattr(self, "speed", SPEEDS[panel.speed.value]))
        panel.reset.on_click(lambda _: ask(actions.reset))
        panel.load.on_click(lambda _: ask(partial(actions.load, panel.scene.value)))
        panel.save.on_click(lambda _: ask(partial(actions.save, panel.name.value)))
        panel.report.on_click(lambda _: ask(partial(actions.report, panel.name.value)))
        panel.go.on_click(lambda _: ask(partial(actions.head_for, *panel.goal.value)))
        panel.family.on_update(lambda _: self._attempt(panel.show_own_object))
        panel.which.on_update(lambda _: ask(panel.show_chosen))
        panel.put.on_click(lambda _: ask(self.new_object(*panel.where.value[:2])))

        def change(_: Any) -> None:
            heavier, slippery, brakes = panel.present
            values = {"set load": heavier.value, "set friction": slippery.value, "set brakes": brakes.value}
            ask(partial(actions.alter, panel.which.value, panel.alter.value, values[panel.alter.value]))

        panel.alter.on_click(change)
        panel.shove.on_click(
            lambda _: ask(partial(actions.shove, panel.which.value, panel.shove.value, panel.impulse.value))
        )
        for slider in panel.control.values():
            slider.on_update(lambda _: ask(self.tune))
        panel.drag.on_update(lambda _: ask(self.pictures.draw_handles))
        for box in panel.shown.values():
            box.on_update(lambda _: ask(self.pictures.draw_lines))
        self.server.on_client_connect(lambda _: ask(panel.look_for_files))
        # A user who disconnects releases the handles.
        self.server.on_client_disconnect(lambda _: ask(self.pictures.draw_handles))
        self.server.scene.on_click()(self.clicked)
