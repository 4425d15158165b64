"""Runs that write a folder: simulate a scenario, then write result.json, trace.npz, report.html and episode.mp4."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shmoo_mjx.base.assets import asset
from shmoo_mjx.base.files import claimed, write_whole
from shmoo_mjx.base.guard import ARRAYS, FILM, HTML, MAP, PNG, RUN, SCENARIO, VIEWER, WEIGHTS, check_folder
from shmoo_mjx.base.options import SENSES, SensesName, shortened
from shmoo_mjx.base.schema import check_angle, validated
from shmoo_mjx.base.seeds import check_seed
from shmoo_mjx.base.verbosity import is_quiet
from shmoo_mjx.base.versions import versions
from shmoo_mjx.base.yaml_input import value_of
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.planning.maps import OccupancyGrid, save_map
from shmoo_mjx.planning.scenario import (
    ROBOT_RADIUS,
    Scenario,
    check_scenario,
    portable,
    save_scenario,
    with_own_objects,
)
from shmoo_mjx.plant.condition import is_custom

if TYPE_CHECKING:
    from shmoo_mjx.control.pushing import PushController
    from shmoo_mjx.report.trace import Trace
    from shmoo_mjx.run.episode import Episode

OWN_WEIGHTS = "weights.safetensors"
"""File name of a run's weights in its folder, if they are not those of its method."""
_FLOOR, _CELL = 12.0, 0.05
"""Side of the open floor of ``shmoo push``, and of its cells [m]."""
_FILES = {
    "trace.npz": ARRAYS,
    "result.json": RUN,
    "scenario.yaml": SCENARIO,
    "map.yaml": MAP,
    "map.png": PNG,
    OWN_WEIGHTS: WEIGHTS,
    "recorded.npz": ARRAYS,
    "report.html": HTML,
    "episode.mp4": FILM,
    "episode.rrd": VIEWER,
}
"""Files of a run's folder. The first one is written first."""


def run_scenario(
    grid: OccupancyGrid,
    scenario: Scenario,
    out: str | Path,
    *,
    weights: Path | None = None,
    video: bool = True,
    name: str = "scenario",
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
    record: bool = False,
    senses: SensesName | None = None,
    real_time: bool = False,
    policy: str | None = None,
    method: str = "ours",
    settings: Sequence[str] = (),
) -> dict[str, Any]:
    """Runs one scenario and writes its folder ``out``.

    Args:
        grid: the map.
        scenario: the scenario to run.
        out: folder for the results; created if absent. Files of an earlier run are replaced.
        weights: trained weights; those of the method if not given.
        video: whether to render episode.mp4, which takes about as long as the simulation.
        name: name of the scenario in error messages.
        progress: called with (stage, elapsed fraction of its limit).
        record: also write episode.rrd, a 3-D recording for the Rerun viewer.
        senses: sensing of the robot; by default the scenario's, or real.
        real_time: run against the wall clock and report every missed deadline.
        policy: "package.module:Name" of a policy that replaces the navigator.
        method: "ours", or "paper" for the paper's system (`shmoo_mjx.behavior.methods`).
        settings: "NAME=VALUE" texts that replace settings of the method (`shmoo_mjx.behavior.settings`).

    Returns:
        The result, as in result.json.

    Raises:
        ShmooError: the scenario does not fit the map, the weights can't be read or do not fit the method, there is no
            such method or setting, or a file in ``out`` does not belong to an earlier run.
    """
    out = Path(out)
    check_run_folder(out)
    check_scenario(grid, scenario, ROBOT_RADIUS, name)
    conditions = checked_objects(grid, scenario, name)
    # Imports that take seconds come after the checks, so that invalid input is reported at once.
    from shmoo_mjx.behavior.methods import method_named
    from shmoo_mjx.behavior.settings import with_settings
    from shmoo_mjx.control.observation import local_distance_field
    from shmoo_mjx.planning.maps import distance_field
    from shmoo_mjx.report.html import write_report
    from shmoo_mjx.report.rerun_file import require_rerun, write_rerun_file
    from shmoo_mjx.run.episode import Hooks, run_episode
    from shmoo_mjx.run.recording import RECORDING_FILE, save_recording

    if record:
        require_rerun()
    chosen = with_settings(method_named(method), settings)
    controller = chosen.controller(weights, to_pose=scenario.push_to is not None)
    with claimed(out):
        # Copied before the run, because the object files may disappear during it.
        scenario = with_own_objects(scenario, out)
        if not is_quiet():
            for i, condition in enumerate(conditions):
                print(f"object {i}: {condition.describe()}")
        limit = scenario.limits.time_s
        hooks = Hooks(progress=lambda t, mode: progress(f"simulating: {mode}", t / limit))
        if real_time:
            # Compilation during the run would miss every deadline.
            controller.compile(local_distance_field(distance_field(grid), scenario.start))
        episode = run_episode(
            grid,
            scenario,
            controller,
            config=chosen.navigator,
            hooks=hooks,
            senses=senses,
            real_time=real_time,
            policy=policy,
        )
        result = save_run(
            out,
            grid,
            scenario,
            result=episode.result,
            trace=episode.trace,
            controller=controller,
            method=method,
            settings=settings,
        )
        save_recording(out / RECORDING_FILE, episode.recorded)
        # The report shows the video in the folder, so one of an earlier run must be removed.
        (out / "episode.mp4").unlink(missing_ok=True)
        (out / "episode.rrd").unlink(missing_ok=True)
        if record:
            write_rerun_file(out / "episode.rrd", result, episode.trace)
        if video:
            _write_video(out / "episode.mp4", result, episode, progress)
        progress("writing the report", 0.9)
        write_report(out)
        progress("done", 1.0)
        return result


def check_run_folder(out: Path) -> None:
    """Checks that a run may write its files to ``out``.

    Raises:
        ShmooError: one of them would replace an input, or a file that does not belong to an earlier run.
    """
    check_folder(out, _FILES, "trace.npz")


def save_run(
    out: Path,
    grid: OccupancyGrid,
    scenario: Scenario,
    *,
    result: dict[str, Any],
    trace: Trace,
    controller: PushController,
    method: str = "ours",
    settings: Sequence[str] = (),
) -> dict[str, Any]:
    """Writes the inputs of a report to the folder ``out``, and everything needed to repeat the run from there.

    The files are trace.npz, map, scenario, object files, weights that are not those of the ``method``, and result.json.

    Returns:
        The result as written, with the versions, weights and settings that it depends on, and the command that repeats
        it.

    Raises:
        ShmooError: a file in ``out`` does not belong to an earlier run.
    """
    from shmoo_mjx.behavior.methods import method_named
    from shmoo_mjx.learning.weights import load_weights, save_weights
    from shmoo_mjx.report.trace import save_trace

    check_run_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    save_trace(out / "trace.npz", trace)
    save_map(grid, out / "map.yaml")
    perceived = result["senses"] if result["senses"] in SENSES else scenario.senses
    own = with_own_objects(scenario.model_copy(update={"map": str(out / "map.yaml"), "senses": perceived}), out)
    save_scenario(own, out / "scenario.yaml")
    shipped = controller.weights.info == load_weights(asset(method_named(method).weights)).info
    if shipped:
        (out / OWN_WEIGHTS).unlink(missing_ok=True)
    else:
        save_weights(out / OWN_WEIGHTS, controller.weights)
    about = {"method": method, "settings": list(settings), "versions": versions(), "weights": controller.weights.info}
    whole = {"name": out.resolve().name, **result, **about}
    whole["command"] = _command(whole["name"], shipped, policy=result["policy"], method=method, settings=settings)
    whole["config"] = result["config"] | {
        "pushing": asdict(controller.config),
        "scenario": portable(own, out).model_dump(mode="json"),
    }
    write_whole(out / "result.json", (json.dumps(whole, indent=1, default=float) + "\n").encode())
    return whole


def _command(name: str, shipped_weights: bool, *, policy: str | None, method: str, settings: Sequence[str]) -> str:
    """The command that repeats a run, in the parent directory of its folder ``name``."""
    words = ["uv", "run", "shmoo", "navigate", "--scenario", f"{name}/scenario.yaml"]
    words += [] if shipped_weights else ["--weights", f"{name}/{OWN_WEIGHTS}"]
    words += [] if policy is None else ["--policy", policy]
    words += [] if method == "ours" else ["--method", method]
    words += ["--set", *settings] if settings else []
    return shlex.join([*words, "--out", f"{name}-again"])


def checked_objects(grid: OccupancyGrid, scenario: Scenario, name: str) -> list[Any]:
    """The conditions of the objects.

    Raises:
        ShmooError: an object has invalid properties, a wrong object file, or stands in an impossible place. The message
            names it.
    """
    from shmoo_mjx.planning.scenario import check_places
    from shmoo_mjx.plant.object_file import read_object

    conditions = []
    for i, entry in enumerate(scenario.objects):
        if is_custom(entry.family):
            read_object(entry.family)  # A fault of this file is none of the properties below.
        try:
            conditions.append(entry.condition())
        except ShmooError as error:
            raise ShmooError(f"{name}: 'objects[{i}].properties': {error}") from None
    check_places(grid, scenario, [c.half_extents for c in conditions], name)
    return conditions


def _write_video(path: Path, result: dict[str, Any], episode: Episode, progress: Callable[[str, float], None]) -> None:
    from shmoo_mjx.plant.render import can_render
    from shmoo_mjx.report import film, video

    if problem := can_render():
        progress(f"no 3-D renderer ({problem}), drawing from above", 0.0)
        frames = video.topdown_frames(result, episode.trace, fps=film.FPS, speed=video.SPEED)
    else:
        draws = partial(progress, "drawing the video")
        frames = film.film_frames(result, episode.trace, episode.scene, episode.qpos, progress=draws)
    video.write_video(path, frames, film.FPS)


def load_inputs(
    map_path: Path | None, scenario_path: Path | None, start: str | None, goal: str | None
) -> tuple[OccupancyGrid, Scenario]:
    """Map and scenario from the options of ``shmoo navigate``.

    Raises:
        ShmooError: there is no map, neither a scenario nor start and goal, or a file has an error.
    """
    from shmoo_mjx.planning.maps import load_map
    from shmoo_mjx.planning.scenario import load_scenario

    if scenario_path is not None:
        if start is not None or goal is not None:
            raise ShmooError(
                "--start and --goal have no effect beside --scenario; give them in the file or leave it out."
            )
        scenario = load_scenario(scenario_path)
    elif start is not None and goal is not None:
        scenario = Scenario(start=_numbers("--start", start, 3), goal=_numbers("--goal", goal, 2))
    else:
        raise ShmooError("navigate needs --scenario FILE, or --map FILE with --start x,y,yaw and --goal x,y.")
    chosen = map_path or (None if scenario.map is None else Path(scenario.map))
    if chosen is None:
        raise ShmooError(f"{scenario_path or 'navigate'}: field 'map' is missing; add it or give --map FILE.")
    seeds = {"seed": scenario.seed} | {f"objects[{i}].seed": o.seed for i, o in enumerate(scenario.objects)}
    for field, seed in seeds.items():
        check_seed(f"{scenario_path}: field '{field}':", seed)
    return load_map(chosen), scenario


def push_inputs(
    family: str, goal: str, properties: Sequence[str], *, seed: int, start: str
) -> tuple[OccupancyGrid, Scenario]:
    """An open floor with one object at the origin, and a scenario that pushes it to a pose: ``shmoo push``.

    Args:
        family: box, cart, wheelchair, or an object file.
        goal: "x,y,yaw" of the object [m, rad].
        properties: "name=value" texts, as in a scenario file.
        seed: seed of the properties that are not given.
        start: "x,y,yaw" of the robot [m, rad].

    Raises:
        ShmooError: an argument is invalid.
    """
    values = {}
    for text in properties:
        name, equals, value = text.partition("=")
        if not equals:
            raise ShmooError(f"--set {shortened(text)!r} must be NAME=VALUE, such as mass=6.")
        values[name] = value_of(value, f"--set {shortened(text)!r}")
    entry = {"family": family, "pose": (0.0, 0.0, 0.0), "seed": seed, "properties": values}
    task = {"start": _numbers("--start", start, 3), "push_to": _numbers("--goal", goal, 3), "objects": [entry]}
    half = round(_FLOOR / 2 / _CELL)
    floor = OccupancyGrid(np.zeros((2 * half, 2 * half), np.int8), _CELL, (-half * _CELL, -half * _CELL, 0.0))
    return floor, validated(Scenario, {**task, "seed": seed}, "push")


def _numbers(option: str, text: str, count: int) -> Any:
    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ShmooError(f"{option} {shortened(text)!r} must be {count} finite numbers separated by commas.")
    for yaw in values[2:]:
        try:
            check_angle(yaw)
        except ValueError as error:
            raise ShmooError(f"{option} {shortened(text)!r}: the yaw {error}") from None
    return values
