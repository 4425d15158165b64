"""Scenario sets: maps, scenarios on them and their known properties in one file, as a common basis of comparisons."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from shmoo_mjx.base.assets import asset
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.guard import SCENARIO_SET, check_output
from shmoo_mjx.base.schema import WholeNumber, read_json, validated
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.navigation_places import Places, SetEntry, find_places, kept_scenario
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.evaluation.scenarios import ScenarioConfig
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.planning.maps import load_map, save_map
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, check_scenario, located
from shmoo_mjx.run.scenario_run import checked_objects


class _Map(BaseModel):
    """The two files of a map in the map_server format."""

    model_config = ConfigDict(extra="forbid")
    yaml: str
    png: str
    """Image as Base64 text."""


class _Set(BaseModel):
    model_config = ConfigDict(extra="forbid")
    format: Literal["shmoo_mjx scenario set 1"] = "shmoo_mjx scenario set 1"
    condition_seeds: tuple[WholeNumber, ...]
    maps: dict[str, _Map] = Field(min_length=1)
    scenarios: tuple[SetEntry, ...] = Field(min_length=1)


def make_set(
    out: Path,
    maps: Path | None = None,
    condition_seeds: Sequence[int] = (0,),
    *,
    per_map: int = 4,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
    drawn: Path = Path("runs/scenarios"),
) -> int:
    """Draw scenarios and write them with their maps to the file ``out``.

    Args:
        out: file of the scenario set.
        maps: folder of maps; None for buildings, which are generated for each condition seed.
        condition_seeds: each of them draws ``per_map`` scenarios on every map.
        per_map: number of scenarios.
        progress: called with (stage, fraction done).
        drawn: folder that keeps each scenario, so that an interrupted command can resume.

    Returns:
        The number of scenarios.

    Raises:
        ShmooError: there are no maps, they have no place for any scenario, or ``out`` is a file of another kind.
    """
    check_output(out, SCENARIO_SET)
    written: dict[str, _Map] = {}
    entries: list[SetEntry] = []
    for turn, seed in enumerate(dict.fromkeys(condition_seeds)):
        places = find_places(ExperimentOptions(condition_seed=seed, maps=maps), drawn, ScenarioConfig())
        named = {name: f"{name}_{seed}" if maps is None else name for name in places.maps}
        written |= {named[name]: _packed(path, named[name]) for name, path in places.maps.items()}
        trials = {f"{name}-{i}": (name, i) for name in places.maps for i in range(per_map)}
        # Scenarios are kept under a fingerprint of their map and settings. These rows have none, so they are not kept.
        with TemporaryDirectory() as scratch:
            for row in run_trials(trials, partial(_drawn, places), Path(scratch), progress):
                number = row["number"] + turn * per_map * (maps is not None)
                entries.append(SetEntry(**row | {"map": named[row["map"]], "number": number}))
    if not entries:
        raise ShmooError(f"--maps {maps}: has no place for any scenario; give maps with doorways or corridors.")
    content = _Set(condition_seeds=tuple(condition_seeds), maps=written, scenarios=tuple(entries))
    lines = json.dumps(content.model_dump(mode="json"), separators=(",", ":"))
    write_whole(out, (lines.replace('{"map":', '\n{"map":') + "\n").encode())
    return len(entries)


def _packed(path: Path, name: str) -> _Map:
    with TemporaryDirectory() as scratch:
        file = Path(scratch) / f"{name}.yaml"
        save_map(load_map(path), file)
        return _Map(yaml=file.read_text(), png=base64.b64encode(file.with_suffix(".png").read_bytes()).decode())


def _drawn(places: Places, trial: tuple[str, int]) -> list[dict[str, Any]]:
    """The row of one scenario; none if the map has no place for it."""
    name, number = trial
    wanted, drawn = kept_scenario(places, load_map(places.maps[name]), name, number)
    place = {"map": name, "number": number, "wanted": wanted}
    return [] if drawn is None else [place | drawn.model_dump(mode="json")]


def find_set(name: Path) -> Path:
    """The file ``name`` if it exists, or else the shipped set of that name (``arena``, ``floor_plans``)."""
    shipped = asset(f"experiments/scenario_sets/{name}.json")
    return shipped if not name.is_file() and shipped.is_file() else name


def open_set(file: Path, folder: Path) -> tuple[Places, int]:
    """Read a scenario set.

    Args:
        file: scenario set.
        folder: folder that the maps are written to.

    Returns:
        The places of the scenarios, and the largest number of scenarios on one map.

    Raises:
        ShmooError: the file is missing or damaged, or a scenario does not fit its map.
    """
    content = validated(_Set, read_json(file, "scenario set", "shmoo scenarios make"), file)
    maps = {name: folder / f"{name}.yaml" for name in content.maps}
    for name, packed in content.maps.items():
        # The name of the map becomes a file name in the folder.
        if not re.fullmatch(r"[^/\\\x00-\x1f]{1,200}", name):
            raise ShmooError(f"{file}: 'maps' has {name!r}; name maps by letters, digits and signs other than slashes.")
        try:
            image = base64.b64decode(packed.png, validate=True)
        except ValueError:
            raise ShmooError(f"{file}: 'maps.{name}.png' is no base64 text; get the file again.") from None
        write_whole(folder / f"{name}.png", image)
        write_whole(maps[name], packed.yaml.encode())
    entries = {}
    for i, entry in enumerate(content.scenarios):
        where = f"{file}: 'scenarios[{i}]'"
        if entry.map not in maps:
            raise ShmooError(f"{where} is on {entry.map!r}, which is not among its maps; add the map.")
        scenario, grid = located(entry.scenario, file.parent), load_map(maps[entry.map])
        check_scenario(grid, scenario, ROBOT_RADIUS, where)
        count = len(checked_objects(grid, scenario, where))
        if not len(entry.movable) == len(entry.blocking) == count:
            raise ShmooError(f"{where} must say 'movable' and 'blocking' of each of its {count} objects.")
        entries[f"{entry.map}-{entry.number}"] = entry.model_copy(update={"scenario": scenario})
    most = 1 + max(entry.number for entry in content.scenarios)
    return Places(maps, folder, 0, ScenarioConfig(), entries), most
