"""The model of the live page, independent of the page: a simulation, and the user's changes to its world.

An impossible request raises a :class:`~shmoo_mjx.errors.ShmooError` before anything changes.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.arrays import finite_numbers
from shmoo_mjx.base.guard import MAP, PNG, SCENARIO, check_output, protected
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.base.schema import validated
from shmoo_mjx.behavior.methods import OURS, method_named
from shmoo_mjx.behavior.push_options import make_options
from shmoo_mjx.behavior.settings import with_settings
from shmoo_mjx.behavior.state import Mode
from shmoo_mjx.control.mppi import Plan
from shmoo_mjx.control.observation import local_distance_field
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.contact_prior import true_values
from shmoo_mjx.learning.weights import Weights
from shmoo_mjx.live.scenes import SceneLoader, files_of
from shmoo_mjx.planning.maps import OccupancyGrid, save_map
from shmoo_mjx.planning.reach import Foresight
from shmoo_mjx.planning.scenario import (
    MOST_OBJECTS,
    ROBOT_RADIUS,
    ObjectEntry,
    Scenario,
    check_place,
    check_point,
    save_scenario,
    with_own_objects,
)
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.run.episode import result_of, trace_of
from shmoo_mjx.run.scenario_run import save_run
from shmoo_mjx.run.simulation import Simulation
from shmoo_mjx.sensing import Senses, senses_named
from shmoo_mjx.types import DT

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}")


class LiveController(PushController):
    """A controller that stores its last plan.

    ``foresee`` predicts the outcomes of its pushes. It does not depend on the settings of MPPI, so that a controller
    that replaces ``previous`` shares the compiled one.
    """

    def __init__(self, weights: Weights, config: PushConfig, previous: LiveController | None = None) -> None:
        super().__init__(weights, config)
        self.last_plan: Plan | None = None
        self.foresee: Foresight = Foresight(weights, config) if previous is None else previous.foresee

    def step(self, *args: Any, **kwargs: Any) -> tuple[np.ndarray, Any, Plan]:
        u, state, plan = super().step(*args, **kwargs)
        self.last_plan = plan
        return u, state, plan


class Session:
    """A simulation that continues across goals.

    Args:
        weights: trained weights.
        load: makes the first scene.
        senses: "real" or "perfect".
        out: folder for saved files.
        settings: "NAME=VALUE" texts that replace settings of the run (`shmoo_mjx.behavior.settings`).
    """

    def __init__(
        self,
        weights: Weights,
        load: SceneLoader,
        senses: SensesName = "real",
        out: Path = Path("runs/live"),
        *,
        settings: Sequence[str] = (),
    ) -> None:
        method = with_settings(method_named(OURS), settings)
        self.settings = tuple(settings)
        """The current settings that differ from the defaults, as texts."""
        self.controller = LiveController(weights, method.pushing)
        self._navigator = method.navigator
        self.senses: Senses = senses_named(senses)
        self.out = out
        self.simulation: Simulation
        self.spent: deque[float] = deque(maxlen=100)
        """Wall-clock time of the last control steps [s]."""
        self.late = 0
        """Number of samples whose computation took longer than a sample time."""
        self.started = 0
        """Number of worlds so far. A change of objects counts as a new world, so that the page redraws it."""
        self.goal_since = 0.0
        """Time at which the current goal was set [s]."""
        self.first = load
        """Makes the first scene again."""
        self._start, self._inputs = load(), files_of(load)
        self._begin(*self._start)

    @property
    def scenario(self) -> Scenario:
        """The current scenario."""
        return self.simulation.scenario

    @property
    def plan(self) -> Plan | None:
        """Roll-outs of the last control step, while an object is being pushed."""
        return self.controller.last_plan if self.simulation.navigator.learned is not None else None

    @property
    def probability(self) -> float | None:
        """Probability that the current push frees the path, from the last decision; None before the first decision."""
        navigator = self.simulation.navigator
        if navigator.mode not in (Mode.PROBE, Mode.PUSH) or not navigator.decisions:
            return None
        last, push = navigator.decisions[-1], navigator.state.current().push
        return last.probability if push is not None and last.t >= push.started else None

    @property
    def force(self) -> float:
        """Horizontal force of the hands [N]."""
        wrench = self.simulation.true.wrench
        return float(np.linalg.norm(wrench[0, :, :2].sum(axis=0))) if wrench.size else 0.0

    def true_values(self, index: int) -> dict[str, float]:
        """Ground truth of the estimated quantities of object ``index`` (`contact_prior.true_values`)."""
        return _true_values(self.simulation.conditions[index])

    def compile(self) -> None:
        """Compiles what the first decision and the first push need. Otherwise the simulation stops for seconds."""
        self._compile(self.controller)
        pose, half = np.zeros(3), (0.3, 0.3)
        options = make_options(pose, half, np.zeros((8, 3))).options
        self.controller.foresee(None, None, pose, half, options=options, seed=0)

    def _compile(self, controller: LiveController) -> None:
        belief, pose = self.simulation.navigator.belief, self.simulation.true.robot_pose[0]
        controller.compile(local_distance_field(belief.clearance(), pose))

    def compiled(self, settings: Sequence[str]) -> LiveController:
        """A compiled controller with the current settings and ``settings``. It changes nothing in this session.

        Raises:
            ShmooError: a setting is not valid.
        """
        config = with_settings(method_named(OURS), (*self.settings, *settings)).pushing
        made = LiveController(self.controller.weights, config, self.controller)
        self._compile(made)
        return made

    def use(self, controller: LiveController, settings: Sequence[str]) -> None:
        """Continues with a controller that `compiled` made for ``settings``, also in the middle of a push."""
        by_name = {text.partition("=")[0]: text for text in (*self.settings, *settings)}
        self.settings, self.controller = tuple(by_name.values()), controller
        self.simulation.navigator.use(controller)

    def close(self) -> None:
        """Stops the simulation's threads."""
        self.simulation.close()

    def load(self, scene: SceneLoader) -> None:
        """Loads another map and scenario."""
        loaded = scene()
        self._begin(*loaded)
        self._start, self._inputs = loaded, files_of(scene)

    def reset(self) -> None:
        """Restores the scene as it was loaded."""
        self._begin(*self._start)

    def _begin(self, grid: OccupancyGrid, scenario: Scenario) -> None:
        fresh = Simulation(grid, scenario, self.controller, config=self._navigator, senses=self.senses)
        if hasattr(self, "simulation"):
            self.simulation.close()
        self.simulation, self.controller.last_plan = fresh, None
        self.spent.clear()
        self.late, self.started, self.goal_since = 0, self.started + 1, 0.0

    def step(self) -> None:
        """Runs one sample of 0.1 s. After a fall or a divergence nothing happens."""
        if self.simulation.history.ended:
            return
        began = time.perf_counter()
        command = self.simulation.decide()
        spent = time.perf_counter() - began
        self.simulation.advance(command)
        self.spent.append(spent)
        self.late += spent > DT

    def head_for(self, x: float, y: float) -> None:
        """Sets another goal in {W} [m]."""
        simulation = self.simulation
        finite_numbers("the goal", (x, y), "x, y")
        check_point(simulation.grid, (x, y), ROBOT_RADIUS, "the goal")
        simulation.scenario = self.scenario.model_copy(update={"goal": (float(x), float(y))})
        simulation.navigator.head_for(np.array([x, y]), simulation.time)
        self.goal_since = simulation.time

    def add(self, family: str, pose: tuple[float, float, float], properties: Mapping[str, Any], seed: int = 0) -> None:
        """Adds an object at ``pose`` (x, y, yaw) in {W}. ``seed`` draws the properties that are not given."""
        if len(self.scenario.objects) >= MOST_OBJECTS:
            raise ShmooError(f"There are {MOST_OBJECTS} objects already; reset the scene.")
        fields = {"family": family, "pose": pose, "properties": dict(properties), "seed": seed}
        entry = validated(ObjectEntry, fields, Path("the new object"))
        self._check_free(f"the {family}", pose, entry.condition().half_extents)
        self._change((*self.scenario.objects, entry))

    def place(self, index: int, pose: tuple[float, float, float]) -> None:
        """Moves object ``index`` to ``pose`` in {W}."""
        entry = self._entry(index)
        self._check_free(f"object {index}", pose, self.simulation.conditions[index].half_extents, index)
        self.simulation.place(index, pose)
        objects = list(self.scenario.objects)
        objects[index] = entry.model_copy(update={"pose": tuple(float(v) for v in pose)})
        self.simulation.scenario = self.scenario.model_copy(update={"objects": tuple(objects)})

    def shove(self, index: int, impulse: float, bearing: float) -> None:
        """Pushes an object by hand.

        Args:
            index: index of the object.
            impulse: impulse [N s].
            bearing: its direction [rad], counterclockwise from the direction from the robot to the object.
        """
        self._entry(index)
        finite_numbers("the shove", (impulse, bearing), "impulse, bearing")
        true = self.simulation.true
        away = true.object_pose[0, index, :2] - true.robot_pose[0, :2]
        angle = float(np.arctan2(away[1], away[0])) + bearing
        self.simulation.shove(index, (impulse * np.cos(angle), impulse * np.sin(angle)))

    def alter(self, index: int, **properties: Any) -> None:
        """Changes ``properties`` (docs/scenario.md) of object ``index`` at once, such as load, brakes or friction."""
        entry, objects = self._entry(index), list(self.scenario.objects)
        objects[index] = entry.model_copy(update={"properties": {**entry.properties, **properties}})
        self._change(tuple(objects))

    def brake(self, index: int, on: bool) -> None:
        """Applies or releases all brakes of an object. A wheelchair has brakes on its rear wheels."""
        family = self._entry(index).family
        count = len(self.simulation.conditions[index].locked)
        if not count:
            raise ShmooError(f"Object {index}, a {Path(family).stem}, has no wheels to brake.")
        braked = 2 if family == "wheelchair" else count
        self.alter(index, locked=[on] * braked + [False] * (count - braked))

    def _change(self, objects: tuple[ObjectEntry, ...]) -> None:
        self.simulation.change(self.scenario.model_copy(update={"objects": objects}))
        self.started += 1

    def _entry(self, index: int) -> ObjectEntry:
        if not 0 <= index < len(self.scenario.objects):
            raise ShmooError(f"There is no object {index}; add one first.")
        return self.scenario.objects[index]

    def _check_free(
        self, what: str, pose: tuple[float, float, float], half_extents: tuple[float, float], index: int = -1
    ) -> None:
        true = self.simulation.true
        others = {
            f"object {i}": (true.object_pose[0, i], c.half_extents)
            for i, c in enumerate(self.simulation.conditions)
            if i != index
        }
        check_place(self.simulation.grid, what, pose, half_extents, robot=true.robot_pose[0, :2], others=others)

    def as_it_stands(self) -> Scenario:
        """The scenario that starts from the current state of the world."""
        true = self.simulation.true
        poses = true.object_pose[0].tolist()
        objects = tuple(
            o.model_copy(update={"pose": tuple(p)}) for o, p in zip(self.scenario.objects, poses, strict=True)
        )
        return self.scenario.model_copy(update={"start": tuple(true.robot_pose[0].tolist()), "objects": objects})

    def save_scenario(self, name: str) -> Path:
        """Writes the current scene and its map as NAME.yaml and NAME.map.yaml to the session's folder.

        The folder also gets a copy of each object file. The files of the loaded scene are not overwritten.
        """
        path = self.out / f"{_checked(name)}.yaml"
        map_path = path.with_suffix(".map.yaml")
        self.out.mkdir(parents=True, exist_ok=True)
        with protected(self._inputs):
            for file, kind in ((path, SCENARIO), (map_path, MAP), (map_path.with_suffix(".png"), PNG)):
                check_output(file, kind)
            scene = with_own_objects(self.as_it_stands().model_copy(update={"map": str(map_path)}), self.out)
            save_map(self.simulation.grid, map_path)
            save_scenario(scene, path)
        return path

    def save_report(self, name: str) -> Path:
        """Writes the run so far as a report to the folder NAME.

        Returns:
            The path of report.html.
        """
        from shmoo_mjx.report.html import write_report

        folder, simulation = self.out / _checked(name), self.simulation
        if not simulation.history.rows:
            raise ShmooError("Nothing has happened yet; let the robot run first.")
        with protected(self._inputs):
            save_run(
                folder,
                simulation.grid,
                self.scenario,
                result=result_of(simulation),
                trace=trace_of(simulation),
                controller=self.controller,
                settings=self.settings,
            )
            (folder / "episode.mp4").unlink(missing_ok=True)
            write_report(folder)
        return folder / "report.html"


@lru_cache(maxsize=64)
def _true_values(condition: Condition) -> dict[str, float]:
    return true_values(condition)


def _checked(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ShmooError(f"{name!r} is no name for a file here; use letters, digits, '_', '-' and '.'.")
    return name
