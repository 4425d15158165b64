"""Maps of the navigation experiments, given or generated, and the scenarios drawn on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from pydantic import BaseModel, Field

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.base.schema import WholeNumber
from shmoo_mjx.base.yaml_input import yaml_files
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.certify import CertifyConfig
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.evaluation.scenarios import EXTRAS, Extra, Generated, Kind, ScenarioConfig, draw_scenario
from shmoo_mjx.planning.floorplan import draw_building
from shmoo_mjx.planning.maps import OccupancyGrid, save_map

BUILDINGS = 5
"""Number of generated buildings if no maps are given."""


class _Place(BaseModel):
    map: str
    number: WholeNumber = Field(ge=0)
    wanted: Kind


class SetEntry(Generated, _Place):
    """A scenario of a scenario set, with its place, its wanted kind, and its known properties."""

    border: Any = Field(None, exclude=True)
    """Field of some files that has no effect."""


@dataclass(frozen=True)
class Places:
    """Maps, and the folder of the scenarios drawn on them."""

    maps: dict[str, Path]
    """YAML file of each map by name."""
    scenarios: Path
    """Folder of the drawn scenarios. Drawing takes minutes and does not depend on policies or weights."""
    first_unseen: int
    """Seed of the first object."""
    config: ScenarioConfig
    entries: Mapping[str, SetEntry] | None = None
    """Scenarios of a scenario set by MAP-NUMBER; None to draw scenarios."""


def find_places(options: ExperimentOptions, folder: Path, config: ScenarioConfig, most: int | None = None) -> Places:
    """The maps of ``options.maps``, or generated buildings if it is None.

    Args:
        options: its condition_seed draws the buildings and the objects.
        folder: folder of the generated buildings and the drawn scenarios.
        config: settings of the scenarios.
        most: maximum number of maps; None for all.

    Raises:
        ShmooError: ``options.maps`` contains no map, or two maps with one name.
    """
    maps = _buildings(folder / "plans", options.first_unseen) if options.maps is None else find_maps(options.maps)
    return Places(dict(list(maps.items())[:most]), folder / "scenarios", options.first_unseen, config)


def find_maps(folder: Path) -> dict[str, Path]:
    """The YAML file of every map_server map (*.yaml or *.yml) below ``folder``, by name.

    Raises:
        ShmooError: there is no map, or there are two maps with one name.
    """
    files = [p for p in yaml_files(folder, below=True) if "image:" in p.read_text(errors="replace")]
    if not files:
        raise ShmooError(f"--maps {folder}: holds no map_server YAML with the field 'image'; give a folder of maps.")
    maps: dict[str, Path] = {}
    for path in files:
        name = "_".join(path.relative_to(folder).with_suffix("").parts)
        if name in maps:
            raise ShmooError(f"--maps {folder}: {maps[name]} and {path} are both called {name}; rename one of them.")
        maps[name] = path
    return maps


def _buildings(folder: Path, first_unseen: int) -> dict[str, Path]:
    folder.mkdir(parents=True, exist_ok=True)
    files = {f"building_{k}": folder / f"building_{first_unseen}_{k}.yaml" for k in range(BUILDINGS)}
    for k, file in enumerate(files.values()):
        save_map(draw_building(np.random.default_rng([first_unseen, k])), file)
    return files


def extras_of(map_name: str, number: int) -> list[Extra]:
    """The range of the extra length for scenario ``number`` of a map, followed by the ranges that may replace it."""
    first = (3 * number + crc32(map_name.encode())) % len(EXTRAS)
    others = [extra for extra in (*EXTRAS[first + 1 :], *EXTRAS[:first]) if extra is not None]
    return [EXTRAS[first], *others, *({None} - {EXTRAS[first]})]


def kept_scenario(places: Places, grid: OccupancyGrid, map_name: str, number: int) -> tuple[Kind, Generated | None]:
    """The wanted kind of scenario ``number`` of a map, and the scenario. It is None if the map has no place for any."""
    if places.entries is not None:
        entry = places.entries[f"{map_name}-{number}"]
        return entry.wanted, entry

    def draw(extra: Extra, rng: np.random.Generator) -> Generated:
        return draw_scenario(grid, extra, rng, places.first_unseen, cfg=places.config)

    scenario = kept(places, grid, map_name, (number,), form=Generated, draw=draw)
    return "unsolvable" if scenario is None else scenario.kind, scenario


def kept[Form: BaseModel](
    places: Places,
    grid: OccupancyGrid,
    map_name: str,
    number: tuple[int, ...],
    *,
    form: type[Form],
    draw: Callable[[Extra, np.random.Generator], Form],
) -> Form | None:
    """The result of ``draw`` for the first range of the extra length that the map has a place for, or None.

    The result is kept in a file. Its name contains a fingerprint of the map, the settings and the code, which includes
    the plant.

    Args:
        places: folder and settings of the scenarios.
        grid: map.
        map_name: name of the map.
        number: number of the scenario on the map, and further numbers that identify the result. They seed the random
            numbers together with the name of the map and the seed of the first object.
        form: type of the result.
        draw: (range of the extra length, random state) -> result. A ShmooError means that the map has no place.
    """
    settings = {
        "frame": [grid.resolution, *grid.origin],
        "scenario": asdict(places.config),
        "truth": asdict(CertifyConfig()),
        "first_unseen": places.first_unseen,
    }
    mark = fingerprint(draw.__module__, settings, grid.cells)
    file = places.scenarios / f"{'-'.join([map_name, *map(str, number)])}-{mark}.json"
    if not file.is_file():
        drawn = None
        for turn, extra in enumerate(extras_of(map_name, number[0])):
            seed = [places.first_unseen, crc32(map_name.encode()), number[0], turn, *number[1:]]
            try:
                drawn = draw(extra, np.random.default_rng(seed))
            except ShmooError:
                continue
            break
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, ("null" if drawn is None else drawn.model_dump_json()).encode())
    text = file.read_text()
    return None if text == "null" else form.model_validate_json(text)
