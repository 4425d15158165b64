"""Scenes and object files that the live page offers: demos, and files of the package and of the user."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from shmoo_mjx.base.assets import asset
from shmoo_mjx.base.inputs import files_read
from shmoo_mjx.base.seeds import seed_of
from shmoo_mjx.base.yaml_input import read_mapping, yaml_files
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.planning.floorplan import demo_scenario
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field, load_map
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Scenario, check_scenario, load_scenario
from shmoo_mjx.run.scenario_run import checked_objects

SceneLoader = Callable[[], tuple[OccupancyGrid, Scenario]]
"""Loads a map and a scenario."""

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


def files_of(scene: SceneLoader) -> set[Path]:
    """All files that a loader of `scenes` or `loader_named` reads."""
    return files_read(getattr(scene, "args", ()))
