"""3-D recording of a run for the Rerun viewer (an optional dependency)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.arrays import Array, Numbers
from shmoo_mjx.base.files import whole
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.planning.maps import OccupancyGrid, occupied_rectangles
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.report.style import COLOURS, object_colour
from shmoo_mjx.report.trace import Trace

_WALL_HEIGHT = 0.6
_OBJECT_HEIGHT = 0.6
_BODY = (0.14, 0.14, 0.45)
"""Half sizes of the box that represents the robot's body [m]."""
_EVIDENCE_LASTS = 3.0
"""Time for which the roll-outs of a decision are visible [s]."""


def require_rerun() -> Any:
    """Import the package of the Rerun viewer.

    Raises:
        ShmooError: the package is not installed.
    """
    try:
        import rerun
    except ImportError:
        raise ShmooError(
            "the 3-D recording needs the package rerun-sdk; get it with `uv sync --extra record` or leave out --record."
        ) from None
    return rerun


def write_rerun_file(path: Path, result: dict[str, Any], trace: Trace) -> Path:
    """Write a recording (.rrd) with walls, robot, objects, plans, roll-outs of the decisions, states and curves.

    Args:
        path: the file to write.
        result: content of ``result.json``.
        trace: the trace of the run.

    Returns:
        ``path``.

    Raises:
        ShmooError: the package of the Rerun viewer is not installed.
    """
    rerun = require_rerun()
    with whole(path) as part:
        stream = rerun.RecordingStream("shmoo_mjx")
        stream.save(str(part))
        _still_parts(rerun, stream, result, trace)
        _motion(rerun, stream, result, trace)
        _plans_and_evidence(rerun, stream, result, trace)
        stream.flush()
        stream.disconnect()
    return path


def _still_parts(rr: Any, stream: Any, result: dict[str, Any], trace: Trace) -> None:
    x, y, yaw = map(float, trace.map_origin)
    grid = OccupancyGrid(np.asarray(trace.map_cells), float(trace.map_resolution), (x, y, yaw))
    walls = np.array(occupied_rectangles(grid, unknown_borders=True)).reshape(-1, 4)
    half = np.full((len(walls), 1), _WALL_HEIGHT / 2)
    turn = rr.RotationAxisAngle((0, 0, 1), radians=grid.origin[2])
    boxes = rr.Boxes3D(
        centers=np.hstack([walls[:, :2], half]),
        half_sizes=np.hstack([walls[:, 2:], half]),
        rotation_axis_angles=[turn] * len(walls),
        colors=[_rgb(COLOURS["wall"])],
        fill_mode="solid",
    )
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("world/walls", boxes, static=True)
    goal = np.array([[*result["goal"][:2], 0.02]]) if result.get("goal") is not None else np.zeros((0, 3))
    stream.log("world/goal", rr.Points3D(goal, radii=0.12, colors=[_rgb(COLOURS["goal"])]), static=True)
    centre, up = (0.0, 0.0, shmoobot().ball_radius), 2 * shmoobot().ball_radius
    blue = [_rgb(COLOURS["robot"])]
    stream.log(
        "world/robot/ball", rr.Ellipsoids3D(centers=[centre], radii=[shmoobot().ball_radius], colors=blue), static=True
    )
    body = rr.Boxes3D(centers=[(0, 0, up + _BODY[2])], half_sizes=[_BODY], colors=blue, fill_mode="solid")
    stream.log("world/robot/lean/body", body, static=True)
    for number, item in enumerate(result["objects"]):
        shape = [(*item["half_extents"], _OBJECT_HEIGHT / 2)]
        colour, label = [_rgb(object_colour(item, number))], [f"{item['family']} {item['id']}"]
        box = rr.Boxes3D(half_sizes=shape, colors=colour, labels=label, fill_mode="solid")
        stream.log(f"world/objects/{number}", box, static=True)


def _motion(rr: Any, stream: Any, result: dict[str, Any], trace: Trace) -> None:
    state = None
    for i, t in enumerate(np.asarray(trace.t, dtype=float)):
        stream.set_time("time", duration=float(t))
        x, y, yaw = map(float, trace.robot_pose[i])
        stream.log("world/robot", _placed(rr, (x, y, 0.0), (0, 0, 1), yaw))
        lean = np.asarray(trace.lean[i], dtype=float)
        # A lean towards +x is a rotation about +y, and a lean towards +y is a rotation about -x.
        axis = np.array([-lean[1], lean[0], 0.0])
        size = float(np.linalg.norm(axis))
        stream.log("world/robot/lean", _placed(rr, (0, 0, 0), axis / size if size else (0, 0, 1), size))
        for number, pose in enumerate(np.asarray(trace.object_pose[i], dtype=float)):
            if np.isfinite(pose).all():
                where = (*map(float, pose[:2]), _OBJECT_HEIGHT / 2)
                stream.log(f"world/objects/{number}", _placed(rr, where, (0, 0, 1), float(pose[2])))
        stream.log("curves/lean_deg", rr.Scalars(np.degrees(lean)))
        stream.log("curves/force_N", rr.Scalars(np.asarray(trace.force[i], dtype=float)))
        if trace.learned_object[i] >= 0:
            stream.log("curves/learned", rr.Scalars(np.asarray(trace.learned[i], dtype=float)))
        if trace.state[i] != state:
            state = trace.state[i]
            stream.log("states", rr.TextLog(trace.state_names[int(state)]))


def _plans_and_evidence(rr: Any, stream: Any, result: dict[str, Any], trace: Trace) -> None:
    for t, plan in zip(np.asarray(trace.plan_times, dtype=float), trace.plans, strict=True):
        stream.set_time("time", duration=float(t))
        stream.log("world/plan", _lines(rr, [np.asarray(plan)], COLOURS["plan"], 0.02))
    for transition in result["transitions"]:
        stream.set_time("time", duration=float(transition["t"]))
        stream.log("reasons", rr.TextLog(f"{transition['from']} -> {transition['to']}: {transition['reason']}"))
    for decision, rollouts in zip(result["decisions"], trace.decision_rollouts, strict=False):
        stream.set_time("time", duration=float(decision["t"]))
        stream.log("world/rollouts", _lines(rr, list(np.asarray(rollouts)), COLOURS["rollout"], 0.005))
        stream.log("reasons", rr.TextLog(f"object {decision['object']}: {decision['reason']}"))
        if decision.get("goal") is not None:
            place = rr.Points3D([[*decision["goal"][:2], 0.7]], radii=0.06, colors=[_rgb(COLOURS["candidate"])])
            stream.log("world/object_goal", place)
        stream.set_time("time", duration=float(decision["t"]) + _EVIDENCE_LASTS)
        stream.log("world/rollouts", rr.Clear(recursive=False))


def _placed(rr: Any, where: Numbers | Array, axis: Numbers | Array, angle: float) -> Any:
    return rr.Transform3D(translation=where, rotation=rr.RotationAxisAngle(axis, radians=angle))


def _lines(rr: Any, lines: list[np.ndarray], colour: str, radius: float) -> Any:
    lifted = [np.column_stack([line[:, :2], np.full(len(line), 0.03)]) for line in lines if len(line)]
    return rr.LineStrips3D(lifted, colors=[_rgb(colour)], radii=radius)


def _rgb(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
