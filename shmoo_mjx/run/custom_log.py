"""Converts a user's own recording to a run for the report: the estimate of the object, and verdicts.

The estimate is that of the robot, sample by sample, and uses no later samples. Only twists use later poses: a parabola
is fitted to the poses within 0.15 s. After each push, roll-outs over the posterior at that time give the probability
that this package's robot can move the object along the pushed side.
"""

from __future__ import annotations

import json
import shlex
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.interpolate import make_interp_spline

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.guard import ARRAYS, HTML, RECORDING, check_folder
from shmoo_mjx.base.verbosity import LOG
from shmoo_mjx.base.versions import versions
from shmoo_mjx.behavior.interaction import ROLLED
from shmoo_mjx.behavior.push_decisions import PROBE_TIME
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.data.differentiate import body_acceleration
from shmoo_mjx.dynamics import object_model
from shmoo_mjx.dynamics.core import Params
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of, heading
from shmoo_mjx.geometry.hands import touches
from shmoo_mjx.learning import online
from shmoo_mjx.learning.estimate import EstimateConfig, Sighting
from shmoo_mjx.learning.weights import Weights, prior_state
from shmoo_mjx.planning.reach import Foresight
from shmoo_mjx.report.trace import Trace, save_trace
from shmoo_mjx.run.log_table import OPTIONAL as OPTIONAL
from shmoo_mjx.run.log_table import REQUIRED as REQUIRED
from shmoo_mjx.run.log_table import check_extents, in_degrees, read_columns
from shmoo_mjx.types import DT

_WINDOW = 0.15
"""Half width of the time window whose poses give a sample's twist [s]."""
_FASTEST = (5.0, 10.0)
"""Speed [m/s] and yaw rate [rad/s] above which the numbers must be in other units."""
_AGAINST = -0.3
"""Ratio of the hands' net work to the sum of its magnitudes, below which the force points against the motion. An object
at rest with noisy poses has a ratio near zero."""
_LOST = 1.0
"""Time without contact after which a push ends [s]."""
_TOLD = 0.05
"""Displacement below which the motion is not informative about mass and friction [m]."""


class Log(NamedTuple):
    """The recording resampled to 10 Hz: T samples in {W}, SI units; NaN where a pose is unknown."""

    t: np.ndarray
    """``[T]`` start of each sample [s]."""
    object_pose: np.ndarray
    """``[T, 3]`` poses of the object."""
    object_twist: np.ndarray
    """``[T, 3]`` twists of the object."""
    wrench: np.ndarray
    """``[T, 3]`` wrench of the hands on the object about its centre, mean over the sample."""
    robot_pose: np.ndarray
    """``[T, 3]`` poses of the robot."""
    doubts: tuple[str, ...] = ()
    """Warnings about numbers that may be in other units."""


def read_log(path: str | Path) -> Log:
    """Reads a recording from a CSV or Parquet file (docs/how_to/recording.md lists its columns) as samples of 0.1 s.

    Raises:
        ShmooError: as `read_columns`, or the numbers are not plausible.
    """
    file = Path(path)
    columns = read_columns(file)
    t = columns["t"]
    pose = np.stack([columns[f"object_{name}"] for name in ("x", "y", "yaw")], axis=-1)
    robot = np.stack([columns.get(f"robot_{name}", np.full(len(t), np.nan)) for name in ("x", "y", "yaw")], axis=-1)
    grid = np.arange(t[0], t[-1] - DT, DT)
    object_pose, object_twist = _smoothed(t, pose, grid)
    fast = np.hypot(object_twist[:, 0], object_twist[:, 1]), np.abs(object_twist[:, 2])
    for values, name, unit, limit in zip(fast, ("object_x", "object_yaw"), ("m", "rad"), _FASTEST, strict=True):
        if np.nanquantile(np.r_[values, 0.0], 0.98) > limit:
            row = int(np.nanargmax(np.abs(columns[name] - np.nanmedian(columns[name])))) + 1
            raise ShmooError(
                f"{file}: '{name}' changes by more than {limit:g} {unit}/s, as in row {row}; give it in {unit}, or "
                "leave the cell empty where it is not known."
            )
    check_extents(file, columns)
    force = np.stack([columns[name] if name in columns else 0 * t for name in ("force_x", "force_y", "torque")], -1)
    wrench = _means(t, force, grid)
    touching = touches(wrench)
    if not touching.any():
        raise ShmooError(f"{file}: 'force_x' and 'force_y' never reach 2 N, so nothing was pushed; give them in N.")
    if not np.isfinite(object_pose[touching]).all(axis=1).any():
        raise ShmooError(
            f"{file}: 'object_x', 'object_y' and 'object_yaw' are never known together while the hands push; "
            "give all three in the same rows."
        )
    return Log(
        grid - grid[0], object_pose, object_twist, wrench, _smoothed(t, robot, grid)[0], tuple(in_degrees(columns))
    )


def _smoothed(t: np.ndarray, pose: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose and twist ``[T, 3]`` at the times ``grid``, from parabolas through the poses near each; NaN with too few."""
    visible = np.isfinite(pose).all(axis=1)
    t, pose = t[visible], pose[visible].copy()
    pose[:, 2] = np.unwrap(pose[:, 2])
    values, slopes = np.full((len(grid), 3), np.nan), np.full((len(grid), 3), np.nan)
    first, last = np.searchsorted(t, grid - _WINDOW - 1e-9), np.searchsorted(t, grid + _WINDOW + 1e-9)
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        near = t[a:b] - grid[k]
        if b - a < 3 or np.ptp(near) < _WINDOW:
            continue
        fit = np.linalg.lstsq(np.stack([near**0, near, near**2], axis=-1), pose[a:b], rcond=None)[0]
        values[k], slopes[k] = fit[0], fit[1]
    values[:, 2] = se2.wrap(values[:, 2])
    return values, slopes


def _means(t: np.ndarray, values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Means over [grid, grid + DT) of values that are linear between the rows. Unknown values count as zero."""
    until = make_interp_spline(t, np.nan_to_num(values), k=1).antiderivative()
    return np.asarray(until(grid + DT) - until(grid)) / DT


def run_of_log(log: Log, half_extents: tuple[float, float], weights: Weights) -> tuple[dict[str, Any], Trace]:
    """The report's inputs for a recording: the content of `result.json` and the trace."""
    visible = np.isfinite(log.object_pose).all(axis=1)
    pushes = [p for p in _pushes(log) if visible[p].any()]
    learned, names, prior, errors, after = _learned(log, half_extents, weights, pushes)
    foresight = Foresight(weights, PushConfig())
    judged = [
        _verdict(log, push, estimated, half_extents=half_extents, foresight=foresight)
        for push, estimated in zip(pushes, after, strict=True)
    ]
    decisions = [d for d in judged if d is not None]
    poses = log.object_pose[visible]
    which = np.full(len(log.t), -1)
    for push in pushes:
        which[push] = 0
    facing = log.robot_pose[:, 2] if np.isfinite(log.robot_pose).all() else log.object_pose[:, 2]
    cells, origin, resolution = _floor(np.concatenate([poses[:, :2], log.robot_pose[:, :2]]), max(half_extents))
    nothing = np.full((len(log.t), 3), np.nan)
    trace = Trace(
        log.t, log.robot_pose, nothing[:, :2], nothing, log.object_pose[:, None],
        np.nan_to_num(se2.rotate(log.wrench[:, :2], -facing)), np.where(which[:, None] >= 0, learned, np.nan), names,
        which, (which >= 0).astype(int), ("free", "push"), cells, origin, resolution, np.zeros(0), (),
        tuple(np.zeros((0, 1, 2)) for _ in decisions), tuple(np.zeros((0, 3)) for _ in decisions),
    )  # fmt: skip
    moves = [d["manipulable"] for d in decisions]
    item = {
        "id": 0,
        "family": "object",
        "half_extents": list(half_extents),
        "registered": bool(moves) and not moves[-1],
    }
    item["description"] = f"{2 * half_extents[0]:g} x {2 * half_extents[1]:g} m"
    ends = {"start_pose": poses[0].tolist(), "final_pose": poses[-1].tolist()}
    warnings = [*log.doubts, *_doubts(log, errors)]
    summary = _summary(log, pushes, moves, learned=learned[-1], names=names, prior=prior, errors=errors)
    result = {
        "outcome": "log",
        "summary": " ".join([summary, *warnings]),
        "warnings": warnings, "transitions": [], "decisions": decisions, "objects": [item | ends],
        "time_s": float(log.t[-1]),
        "learned": dict(zip(names, learned[-1].tolist(), strict=True)), "prior": prior, "unexplained": errors,
        "versions": versions(),
    }  # fmt: skip
    return result, trace


def _learned(
    log: Log, half_extents: tuple[float, float], weights: Weights, pushes: list[slice]
) -> tuple[np.ndarray, tuple[str, ...], dict[str, float], dict[str, float], list[online.LearnerState]]:
    """The estimate after each sample and after each push.

    Returns:
        The estimate after each sample ``[T, n]``, the names of its n values, the prior, the share of the squared
        accelerations that prior and estimate leave unexplained (the estimate uses only earlier samples; empty if
        nothing was learned), and the learner state after each of the ``pushes``.
    """
    params, shape, yaw = weights.params, weights.config.object, log.object_pose[:, 2]
    # Poses of a log have no age. Its forces come from a sensor, not from motors that also hold the arms.
    config = EstimateConfig(lag=0.0, force_error=(0.05, 0.5))
    learner = online.learner(shape, config)
    twist, wrench = se2.rotate(log.object_twist, -yaw), se2.rotate(log.wrench, -yaw)
    before = np.concatenate([np.zeros((1, 3)), twist[:-1]]), np.concatenate([np.zeros((1, 3)), wrench[:-1]])
    size = np.full(len(log.t), np.hypot(*half_extents))
    inputs = np.concatenate([twist, wrench, before[0], size[:, None], before[1]], axis=-1)
    labels = np.concatenate([body_acceleration(log.object_pose, log.object_twist), np.full((1, 3), np.nan)])
    moving = np.hypot(twist[:, 0], twist[:, 1]) > 0.03
    valid = (touches(log.wrench) | moving) & np.isfinite(inputs).all(axis=1)
    end = np.minimum(np.arange(len(log.t)) + 1, len(log.t) - 1)
    visible = np.isfinite(log.object_pose[end]).all(axis=1) & np.isfinite(log.object_twist[end]).all(axis=1)
    poses, twists = np.nan_to_num(log.object_pose[end]), np.nan_to_num(log.object_twist[end])
    sighting = Sighting(poses, twists, np.zeros(len(end)), visible, log.wrench, size)
    start = prior_state(weights, config)
    rows = online.Transition(np.nan_to_num(inputs).astype(np.float32), labels.astype(np.float32), valid, sighting)
    learned, guesses, first = _sample_by_sample(learner, shape, params, start, rows=rows)
    use, scale = valid & np.isfinite(labels).all(axis=1), np.asarray(params.object.label_scale)
    spread = np.sum((labels[use] / scale) ** 2)
    errors = {
        name: float(np.sum(((np.asarray(p)[use] - labels[use]) / scale) ** 2) / spread)
        for name, p in (("prior", first), ("learned", guesses))
        if spread > 0
    }
    prior, after, done = online.summary(start), [start], 0
    for push in pushes:
        after.append(_known_after(learner, params, after[-1], rows, first=done, end=push.stop))
        done = push.stop
    return np.asarray(learned, dtype=float), tuple(prior), prior, errors, after[1:]


@partial(jax.jit, static_argnums=0)
def _known_after(
    learner: online.Learner,
    params: Params,
    estimated: online.LearnerState,
    rows: online.Transition,
    *,
    first: int,
    end: int,
) -> online.LearnerState:
    """The learner state after the ``rows`` from ``first`` to before ``end``. A scan would store it for every row."""

    def step(i: Array, estimated: Any) -> Any:
        return learner.adapt(estimated, params, jax.tree.map(lambda x: x[i], rows))

    return jax.lax.fori_loop(first, end, step, estimated)


@partial(jax.jit, static_argnums=(0, 1))
def _sample_by_sample(
    learner: online.Learner,
    shape: object_model.ObjectConfig,
    params: Params,
    start: online.LearnerState,
    *,
    rows: online.Transition,
) -> tuple[Array, Array, Array]:
    """The estimate after each of the ``rows``, and the predicted accelerations.

    They are predicted before each row from the estimate at that time, and from ``start``.
    """

    def predicted(estimated: Any, x: Array) -> Array:
        own = learner.params_for_rollout(estimated, params)
        return object_model.predict(own.object, own.coefficients, x, shape, contact=own.contact)

    def step(estimated: Any, sample: online.Transition) -> tuple[Any, tuple[Array, Array]]:
        guess = predicted(estimated, sample.inputs)
        estimated = learner.adapt(estimated, params, sample)
        return estimated, (online.summary_values(estimated), guess)

    _, (learned, guesses) = jax.lax.scan(step, start, rows)
    return learned, guesses, jax.vmap(partial(predicted, start))(rows.inputs)


def _doubts(log: Log, errors: dict[str, float]) -> list[str]:
    """Warnings about the result: negative work of the hands, or accelerations that the model does not explain."""
    if _moved(log) < _TOLD:
        return []
    doubts = []
    power = np.nan_to_num(np.sum(log.wrench * log.object_twist, axis=1)) * touches(log.wrench)
    work = float(power.sum()) * DT
    if work < _AGAINST * float(np.abs(power).sum()) * DT:
        doubts.append(
            f"The hands do {work:.1f} J of work on the object, so the force points against its motion: it must be that "
            "of the hands on the object, in the frame of the poses."
        )
    if errors.get("learned", 0.0) > 1.0:
        doubts.append(
            "Under these forces, what was learned predicts its accelerations worse than to predict none, which is not "
            "plausible: check units, sign and frame of the forces."
        )
    return doubts


def _moved(log: Log) -> float:
    """Maximum distance of the object from its first pose [m]."""
    poses = log.object_pose[np.isfinite(log.object_pose).all(axis=1), :2]
    return float(np.linalg.norm(poses - poses[0], axis=1).max())


def _pushes(log: Log) -> list[slice]:
    """Intervals in which the hands touch the object. Short losses of contact do not end an interval."""
    touching = np.flatnonzero(touches(log.wrench))
    parts = np.split(touching, np.flatnonzero(np.diff(touching) * DT > _LOST) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts]


def _verdict(
    log: Log, push: slice, estimated: online.LearnerState, *, half_extents: tuple[float, float], foresight: Foresight
) -> dict[str, Any] | None:
    """Verdict whether the object can be moved, from the estimate after a push; None if the push was too short."""
    touching = touches(log.wrench[push])
    # The last sample's force acts until its end, which is the start of the next sample.
    poses = log.object_pose[push.start : push.stop + 1]
    poses = poses[np.isfinite(poses).all(axis=1)]
    contact, moved = float(touching.sum() * DT), float(np.linalg.norm((poses[-1] - poses[0])[:2]))
    if contact < PROBE_TIME - 1e-6 and moved <= ROLLED:
        return None
    force, faces = log.wrench[push][touching, :2].sum(axis=0), faces_of(half_extents)
    off = se2.wrap(np.arctan2(force[1], force[0]) - heading(poses[-1], faces))
    p = foresight.probability_to_move(estimated, None, poses[-1], half_extents, face=faces[np.argmin(np.abs(off))])
    reason = f"after {contact:.1f} s of contact, in which it moved {moved:.2f} m: a {p:.0%} chance that it can be moved"
    told = {"t": float(log.t[push.stop - 1] + DT), "object": 0, "probability": p, "manipulable": p >= 0.5}
    return told | {"K": None, "G": None, "goal": None, "reason": reason}


def _floor(points: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray, float]:
    """A map of free cells that contains all ``points [N, 2]``: cells, origin and resolution. A log has no map."""
    points = points[np.isfinite(points).all(axis=1)]
    low, high, cell = points.min(axis=0) - margin - 1.0, points.max(axis=0) + margin + 1.0, 0.1
    width, height = np.ceil((high - low) / cell).astype(int)
    return np.zeros((height, width), np.int8), np.array([*low, 0.0]), cell


def _summary(
    log: Log, pushes: list[slice], moves: list[bool], *, learned: np.ndarray, names: tuple[str, ...],
    prior: dict[str, float], errors: dict[str, float],
) -> str:  # fmt: skip
    force = np.hypot(*log.wrench[:, :2].T).max()
    count = f"{len(pushes)} push{'es' * (len(pushes) != 1)}"
    sentences = [f"A recording of {log.t[-1]:.0f} s with {count} of up to {force:.0f} N."]
    if moves:
        sentences.append(
            "The last verdict: the object can be moved." if moves[-1] else "The last verdict: it can't be moved."
        )
    else:
        sentences.append("No push was long enough for a verdict: 1 s of contact, or 0.1 m.")
    if _moved(log) < _TOLD:
        return " ".join([*sentences, f"It moved less than {_TOLD:g} m, too little to tell its mass and friction."])
    if "mass" in prior:
        (along, across, mass), before = (
            [
                f"{of[name]:.3g} {unit} ({of[f'{name}_low']:.3g} to {of[f'{name}_high']:.3g})"
                for name, unit in (("friction_x", "N"), ("friction_y", "N"), ("mass", "kg"))
            ]
            for of in (dict(zip(names, learned, strict=True)), prior)
        )
        sentences.append(
            f"Friction holds it with up to {along} along and {across} across, and it moves like {mass}; in brackets "
            f"the 80 % bands. Before it was touched, {before[0]}, {before[1]} and {before[2]} were expected."
        )
    if errors:
        sentences.append(
            f"The estimate before each sample leaves {errors['learned']:.0%} of the squared accelerations unexplained, "
            f"the prior {errors['prior']:.0%}."
        )
    return " ".join(sentences)


def write_run(file: Path, size: tuple[float, float], out: Path, weights: Weights) -> Path:
    """Writes the report of the recording ``file`` with an object of ``size [2]`` [m] into ``out``.

    Returns:
        The path of the report.

    Raises:
        ShmooError: as `read_log`, or a file in ``out`` does not belong to an earlier report of a recording.
    """
    from shmoo_mjx.report.html import write_report

    check_folder(out, {"trace.npz": ARRAYS, "result.json": RECORDING, "report.html": HTML}, "trace.npz")
    result, trace = run_of_log(read_log(file), (size[0] / 2, size[1] / 2), weights)
    for warning in result["warnings"]:
        LOG.warning("shmoo: %s: %s", file, warning)
    command = f"uv run shmoo report {shlex.quote(file.name)} --size {size[0]:g} {size[1]:g}"
    save_trace(out / "trace.npz", trace)
    write_whole(out / "result.json", (json.dumps(result | {"name": file.stem, "command": command}) + "\n").encode())
    return write_report(out)
