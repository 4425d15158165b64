"""The model of the live page, independent of the page: a simulation, and the user's changes to its world.

An impossible request raises a :class:`~shmoo_mjx.errors.ShmooError` before anything changes.
"""

from __future__ import annotations

import math
import re
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.arrays import finite_numbers
from shmoo_mjx.base.assets import asset
from shmoo_mjx.base.guard import MAP, PNG, SCENARIO, check_output, protected
from shmoo_mjx.base.inputs import files_read
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.base.schema import validated
from shmoo_mjx.base.seeds import seed_of
from shmoo_mjx.base.yaml_input import read_mapping, yaml_files
from shmoo_mjx.behavior.state import Mode
from shmoo_mjx.control.mppi import Plan
from shmoo_mjx.control.observation import local_distance_field
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import online
from shmoo_mjx.learning.weights import Weights, prior_state
from shmoo_mjx.planning.floorplan import demo_scenario
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field, load_map, save_map
from shmoo_mjx.planning.scenario import (
    MOST_OBJECTS,
    ROBOT_RADIUS,
    ObjectEntry,
    Scenario,
    check_place,
    check_point,
    check_scenario,
    load_scenario,
    save_scenario,
    with_own_objects,
)
from shmoo_mjx.run.episode import result_of, trace_of
from shmoo_mjx.run.scenario_run import checked_objects, save_run
from shmoo_mjx.run.simulation import Simulation
from shmoo_mjx.sensing import Senses, senses_named
from shmoo_mjx.types import DT

SceneLoader = Callable[[], tuple[OccupancyGrid, Scenario]]
"""Loads a map and a scenario."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}")
_DEMOS = 20
_OBJECT_FILE = 100_000
"""Maximum size of an object file [bytes]."""


def scenes(own: Path) -> dict[str, SceneLoader]:
    """Loaders of all available scenes by name: the demo's floor plans, and the scenarios and maps found.

    Files come from the package, from ``own`` and from the working directory. A map is an empty scene.
    """
    loaders: dict[str, SceneLoader] = {f"demo {seed}": partial(demo_scenario, seed) for seed in range(_DEMOS)}
    shipped = [asset(f"experiments/{kind}") for kind in ("scenarios", "maps")]
    for path, text in _texts(path for folder in (*shipped, *_own_folders(own)) for path in yaml_files(folder)):
        if "image:" in text:
            loaders[f"map {path.stem.removesuffix('.map')}"] = partial(_from_file, path)
        elif "start:" in text:
            loaders[path.stem] = partial(_from_file, path)
    return loaders


def object_files(own: Path) -> dict[str, Path]:
    """Object files from ``shmoo object add`` in the working directory or in ``own``, by name."""
    paths = (path for folder in _own_folders(own) for path in sorted(folder.glob("*.json")))
    return {path.stem: path.resolve() for path, text in _texts(paths, _OBJECT_FILE) if '"hull"' in text}


def _texts(paths: Iterable[Path], longest: float = math.inf) -> Iterator[tuple[Path, str]]:
    """Path and content of the files that can be read and have at most ``longest`` bytes."""
    for path in paths:
        try:
            text = path.read_text(errors="replace") if path.stat().st_size <= longest else None
        except OSError:  # a folder, a broken link, or a file without read permission
            continue
        if text is not None:
            yield path, text


def _own_folders(own: Path) -> tuple[Path, Path]:
    return own, Path()


def scene_named(name: str, own: Path) -> tuple[OccupancyGrid, Scenario]:
    """Loads the scene with this name, a demo of any seed, or a scenario file."""
    return loader_named(name, own)()


def loader_named(name: str, own: Path) -> SceneLoader:
    """The loader of the scene with this name, of a demo of any seed, or of a scenario file."""
    loaders = scenes(own)
    if name in loaders:
        return loaders[name]
    if name.startswith("demo ") and name[5:].isdigit():
        return partial(demo_scenario, seed_of("the scene's seed", name[5:]))
    if name.endswith((".yaml", ".yml")):
        return partial(_from_file, Path(name))
    others = ", ".join(other for other in loaders if not other.startswith("demo "))
    raise ShmooError(f"{name!r} is no scene; choose 'demo SEED', a scenario or map file (*.yaml), or one of {others}.")


def _from_file(path: Path) -> tuple[OccupancyGrid, Scenario]:
    if "image" in read_mapping(path, "map or scenario"):
        return _empty(load_map(path))
    scenario = load_scenario(path)
    if scenario.map is None:
        raise ShmooError(f"{path}: field 'map' is missing; add it.")
    if scenario.push_to is not None:
        raise ShmooError(f"{path}: the live page drives to goals; give 'goal' for 'push_to', or use shmoo navigate.")
    grid = load_map(Path(scenario.map))
    check_scenario(grid, scenario, ROBOT_RADIUS, str(path))
    checked_objects(grid, scenario, str(path))
    return grid, scenario


def _empty(grid: OccupancyGrid) -> tuple[OccupancyGrid, Scenario]:
    """The map with the robot at the place with the most clearance, which is also the goal."""
    room = np.asarray(distance_field(grid).values)
    if room.max() < ROBOT_RADIUS:
        raise ShmooError(f"{grid.source}: has no room for a robot of radius {ROBOT_RADIUS:.2f} m; give another map.")
    x, y = (round(float(v), 3) for v in grid.cell_to_world(np.array(np.unravel_index(room.argmax(), room.shape))))
    return grid, Scenario(start=(x, y, 0.0), goal=(x, y))


def _files_of(scene: SceneLoader) -> set[Path]:
    """All files that a loader of `scenes` or `loader_named` reads."""
    return files_read(getattr(scene, "args", ()))


class _Watched(PushController):
    """A controller that stores its last plan."""

    last_plan: Plan | None = None

    def step(self, *args: Any, **kwargs: Any) -> tuple[np.ndarray, Any, Plan]:
        u, state, plan = super().step(*args, **kwargs)
        self.last_plan = plan
        return u, state, plan


class Session:
    """A simulation that continues across goals. ``load`` makes the first scene; ``out`` is for saved files."""

    def __init__(self, weights: Weights, load: SceneLoader, senses: SensesName = "real", out: Path = Path("runs/live")):
        self.controller = _Watched(weights)
        self.senses: Senses = senses_named(senses)
        self.out = out
        self.simulation: Simulation
        self.spent: deque[float] = deque(maxlen=100)
        """Wall-clock time of the last control steps [s]."""
        self.late = 0
        """Number of samples whose computation took longer than a sample time."""
        self.started = 0
        """Number of worlds so far. A change of objects counts as a new world, so that the page redraws it."""
        self.first = load
        """Makes the first scene again."""
        self._start, self._inputs = load(), _files_of(load)
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

    @cached_property
    def prior(self) -> dict[str, float]:
        """Prior of an object before contact (`online.summary`)."""
        return online.summary(prior_state(self.controller.weights, self.controller.config.estimate))

    def compile(self) -> None:
        """Compiles what the first push needs. Otherwise the simulation stops for seconds when it begins."""
        belief, pose = self.simulation.navigator.belief, self.simulation.true.robot_pose[0]
        self.controller.compile(local_distance_field(belief.clearance(), pose))

    def close(self) -> None:
        """Stops the simulation's threads."""
        self.simulation.close()

    def load(self, scene: SceneLoader) -> None:
        """Loads another map and scenario."""
        loaded = scene()
        self._begin(*loaded)
        self._start, self._inputs = loaded, _files_of(scene)

    def reset(self) -> None:
        """Restores the scene as it was loaded."""
        self._begin(*self._start)

    def _begin(self, grid: OccupancyGrid, scenario: Scenario) -> None:
        fresh = Simulation(grid, scenario, self.controller, senses=self.senses)
        if hasattr(self, "simulation"):
            self.simulation.close()
        self.simulation, self.controller.last_plan = fresh, None
        self.spent.clear()
        self.late, self.started = 0, self.started + 1

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
            )
            (folder / "episode.mp4").unlink(missing_ok=True)
            write_report(folder)
        return folder / "report.html"


def _checked(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ShmooError(f"{name!r} is no name for a file here; use letters, digits, '_', '-' and '.'.")
    return name
