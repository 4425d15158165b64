"""``shmoo view``: a scene in MuJoCo's viewer with keyboard teleoperation, or a video if no window can open."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.files import whole
from shmoo_mjx.base.guard import FILM, PNG, check_output
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.hands import HAND_RADIUS, REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.run import teleop
from shmoo_mjx.types import DT


def scene_named(what: str, seed: int) -> Scene:
    """The scene with this name: robot, demo, an object family, an object file (*.json) or a scenario file (*.yaml).

    Raises:
        ShmooError: there is no such scene, or the file has an error.
    """
    if what == "robot":
        return build_scene()
    if what in FAMILIES or what.endswith(".json"):
        condition = draw_condition(what, seed)
        return build_scene([(condition, (REACH + HAND_RADIUS + 0.1 + condition.half_extents[0], 0.0, 0.0))])
    from shmoo_mjx.planning.floorplan import demo_scenario
    from shmoo_mjx.run.scenario_run import load_inputs
    from shmoo_mjx.run.simulation import conditions_of, scene_of

    if what == "demo":
        grid, scenario = demo_scenario(seed)
    elif what.endswith((".yaml", ".yml")):
        grid, scenario = load_inputs(None, Path(what), None, None)
    else:
        names = ", ".join(("robot", "demo", *FAMILIES))
        raise ShmooError(f"view {what!r}: choose one of {names}, an object file (*.json) or a scenario file (*.yaml).")
    return scene_of(grid, scenario, conditions_of(scenario))


def interactive(scene: Scene, record: Path | None = None) -> None:
    """Shows the scene in MuJoCo's viewer until it is closed. Keys drive the robot (teleop.KEYS).

    The drive is added to the data set ``record``, which needs a scene with one object.
    """
    import mujoco.viewer

    if record is not None and len(scene.conditions) != 1:
        raise ShmooError(f"--record needs a scene with one object, not {len(scene.conditions)}; view a family or file.")
    engine, data = MujocoEngine([scene]), mujoco.MjData(scene.model)
    pressed: queue.SimpleQueue[int] = queue.SimpleQueue()
    session = teleop.begin(engine, record is not None)
    with mujoco.viewer.launch_passive(scene.model, data, key_callback=pressed.put, show_left_ui=False) as window:

        def show(world: Any) -> None:
            with window.lock():
                data.qpos[:] = world.physics[0, 1 : 1 + scene.model.nq]
                mujoco.mj_forward(scene.model, data)
            window.sync()

        while window.is_running():
            started = time.monotonic()
            keys = [pressed.get() for _ in range(pressed.qsize())]
            session = teleop.tick(engine, session, keys, record=record is not None, show=show)
            time.sleep(max(0.0, DT - (time.monotonic() - started)))
    engine.close()
    if record is not None and len(session.rows) > 10:
        print(f"{record}: {teleop.save(record, scene.conditions[0], session.rows)}, {len(session.rows) * DT:.0f} s")


def film(scene: Scene, out: Path, seconds: float = 8.0) -> list[Path]:
    """Renders a still of the whole scene and a video of the robot, which pushes a single object or turns around.

    Raises:
        ShmooError: no renderer works here, or a file in ``out`` may not be replaced.
    """
    from PIL import Image

    from shmoo_mjx.plant.render import can_render, frames, overview
    from shmoo_mjx.report.video import write_video

    for name, kind in (("scene.png", PNG), ("view.mp4", FILM)):
        check_output(out / name, kind)
    if problem := can_render():
        raise ShmooError(f"view: no window and no 3-D renderer here ({problem}); shmoo doctor says what to install.")
    with whole(out / "scene.png") as temporary:
        Image.fromarray(overview(scene)).save(temporary, format="png")
    qpos = np.array(list(_drive(scene, seconds)))
    write_video(out / "view.mp4", frames(scene, qpos[::2], distance=3.0), 25)
    return [out / "scene.png", out / "view.mp4"]


def _drive(scene: Scene, seconds: float) -> Iterator[np.ndarray]:
    """Configurations ``[nq]`` at 50 Hz of a drive with fixed key presses."""
    pushing = len(scene.conditions) == 1 and not scene.wall_geoms
    turns = {round(i): [263] * 2 for i in np.linspace(8, 10 * seconds - 10, 24)}
    script: dict[int, list[int]] = {0: [257]} | ({8: [265] * 6, 30: [46] * 3} if pushing else turns)
    pictures: list[Any] = []
    engine = MujocoEngine([scene])
    session = teleop.begin(engine)
    for i in range(round(seconds / DT)):
        session = teleop.tick(engine, session, script.get(i, []), show=pictures.append)
        yield from (world.physics[0, 1 : 1 + scene.model.nq] for world in pictures)
        pictures.clear()
    engine.close()
