"""Where the navigation experiments take place: maps that are given or generated, and the scenarios kept for them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.manipulable import BORDER, SteadyPush
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.evaluation.scenarios import KINDS, PLANT, Generated, Kind, ScenarioConfig, draw_scenario
from shmoo_mjx.files import write_whole
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.navigation.floorplan import draw_floorplan
from shmoo_mjx.navigation.maps import OccupancyGrid, save_map
from shmoo_mjx.navigation.scenario import Scenario
from shmoo_mjx.navigation.yaml_input import yaml_files

FLOOR_PLANS = 5
"""Generated where no maps are given."""


@dataclass(frozen=True)
class Places:
    """Maps, and the folder of what is drawn on them."""

    maps: dict[str, Path]
    """Name to YAML."""
    scenarios: Path
    """Folder of the drawn scenarios. They take minutes to draw, and hang neither on policies nor on weights."""
    first_unseen: int
    """Seed of the first object."""
    config: ScenarioConfig
    given: dict[str, dict[str, Any]] | None = None
    """Scenarios of a scenario set, by MAP-NUMBER, in the place of what would be drawn."""


def find_places(options: ExperimentOptions, folder: Path, config: ScenarioConfig, most: int | None = None) -> Places:
    """The maps of ``options.maps``, or else generated floor plans, which are written into ``folder``; ``most`` of them.

    Raises:
        ShmooError: ``options.maps`` holds none.
    """
    maps = _floor_plans(folder / "plans", options.first_unseen) if options.maps is None else find_maps(options.maps)
    return Places(dict(list(maps.items())[:most]), folder / "scenarios", options.first_unseen, config)


def find_maps(folder: Path) -> dict[str, Path]:
    """Name to YAML of every map_server map (*.yaml or *.yml) below ``folder``.

    Raises:
        ShmooError: there is none, or there are two of one name.
    """
    found = [p for p in yaml_files(folder, below=True) if "image:" in p.read_text(errors="replace")]
    if not found:
        raise ShmooError(f"--maps {folder}: holds no map_server YAML with the field 'image'; give a folder of maps.")
    maps: dict[str, Path] = {}
    for path in found:
        name = "_".join(path.relative_to(folder).with_suffix("").parts)
        if name in maps:
            raise ShmooError(f"--maps {folder}: {maps[name]} and {path} are both called {name}; rename one of them.")
        maps[name] = path
    return maps


def _floor_plans(folder: Path, first_unseen: int) -> dict[str, Path]:
    folder.mkdir(parents=True, exist_ok=True)
    files = {f"plan_{k}": folder / f"plan_{first_unseen}_{k}.yaml" for k in range(FLOOR_PLANS)}
    for k, file in enumerate(files.values()):
        save_map(draw_floorplan(np.random.default_rng([first_unseen, k])).grid, file)
    return files


def kinds_of(map_name: str, number: int) -> list[Kind]:
    """The kind that scenario ``number`` of a map is to be, then the others in the order in which they may replace it.

    The kinds take turns. Those that stand in for a kind that a map has no place for take turns as well.
    """
    first = (number + crc32(map_name.encode())) % len(KINDS)
    others = [kind for kind in KINDS if kind != KINDS[first]]
    return [KINDS[first], *(others if number // len(KINDS) % 2 else others[::-1])]


def kept_scenario(places: Places, grid: OccupancyGrid, map_name: str, number: int) -> tuple[Kind, Generated | None]:
    """The kind that scenario ``number`` of a map was to be, and the scenario; None if the map has no place for any."""
    if places.given is not None:
        entry = dict(places.given[f"{map_name}-{number}"])
        return entry.pop("wanted"), generated_from(entry)

    def draw(kind: Kind, rng: np.random.Generator) -> dict[str, Any]:
        return as_data(draw_scenario(grid, kind, rng, places.first_unseen, PLANT, places.config))

    data = kept(places, grid, map_name, (number,), draw)
    wanted = kinds_of(map_name, number)[0]
    return wanted, None if data is None else generated_from(data)


def as_data(found: Generated) -> dict[str, Any]:
    """A scenario as it is written."""
    return found._asdict() | {"scenario": found.scenario.model_dump(mode="json")}


def generated_from(data: dict[str, Any]) -> Generated:
    """A scenario as it was written."""
    lists = {name: tuple(data[name]) for name in ("movable", "blocking", "border")}
    return Generated(**data | lists | {"scenario": Scenario.model_validate(data["scenario"])})


def kept(
    places: Places,
    grid: OccupancyGrid,
    map_name: str,
    number: tuple[int, ...],
    draw: Callable[[Kind, np.random.Generator], dict[str, Any]],
) -> dict[str, Any] | None:
    """What ``draw`` returns for the first kind in turn that the map has a place for, or None if it has for no kind.

    It is kept as a file that goes with the function, the map, the settings and the plant. ``number`` begins with the
    scenario's; with map and objects it fixes the random numbers, and other maps beside this one change nothing.
    """
    settings = {
        "frame": [grid.resolution, *grid.origin],
        "scenario": asdict(places.config),
        "truth": [asdict(SteadyPush()), BORDER],
        "first_unseen": places.first_unseen,
    }
    mark = fingerprint(draw.__module__, settings, grid.cells)
    file = places.scenarios / f"{'-'.join([map_name, *map(str, number)])}-{mark}.json"
    if not file.is_file():
        found = None
        for turn, kind in enumerate(kinds_of(map_name, number[0])):
            seed = [places.first_unseen, crc32(map_name.encode()), number[0], turn, *number[1:]]
            try:
                found = draw(kind, np.random.default_rng(seed))
            except ShmooError:
                continue
            break
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, (json.dumps(found) + "\n").encode())
    data: dict[str, Any] | None = json.loads(file.read_text())
    return data
