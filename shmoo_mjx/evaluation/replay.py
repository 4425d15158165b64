"""Replay of recordings in the plant with the true object, pushed by the mean wrench of each sample.

A predictor sees the mean planar wrench of a sample. Within the sample the forces of the hands vary and have a vertical
part, and the object sags and tips a little. None of this is among the inputs of psi, so even the simulator with the
true object misses part of the acceleration. The replay is a reference for the predictors of the comparison. It is no
lower bound of their error, because the error of one sample may contain information about the next. Roll-outs of the
replay over seconds drift as well, because the recorded wrenches stay close to the friction limit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np

from shmoo_mjx.base.assets import asset
from shmoo_mjx.data import store
from shmoo_mjx.dynamics import features
from shmoo_mjx.evaluation import scoring
from shmoo_mjx.evaluation.baselines import Predictor, recordings
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import object_spec
from shmoo_mjx.types import DT

SETTLE = 0.4
"""Time for the object to settle into its contacts before a recording is replayed [s]."""


def score(objects: store.Dataset, scale: np.ndarray, fit_samples: int = scoring.FIT_SAMPLES) -> dict[str, np.ndarray]:
    """Scores of the replay, with the measures of `scoring`.

    Args:
        objects: recordings of C conditions.
        scale: ``[m]`` standard deviation of the labels over the training set.
        fit_samples: number of first rows that are not scored.

    Returns:
        Measure -> ``[C]``.
    """
    recorded = recordings(objects)
    rows, predicted, ends = recorded.samples, [], []
    for i, condition in enumerate(objects.conditions):
        chosen = {h: scoring.stretches(rows.run[i], rows.weights[i], fit_samples, h) for h in scoring.HORIZONS.values()}
        starts = {h: first[counts].tolist() for h, (first, counts) in chosen.items()}
        poses = np.asarray(recorded.pose[i])
        one_step, rolled = accelerations(
            condition, np.asarray(rows.inputs[i]), poses, np.asarray(rows.run[i]), starts=set().union(*starts.values())
        )
        predicted.append(one_step)
        ends.append(_ends(starts, rolled, poses))
    # The replayed accelerations take the place of the inputs, so a predictor that returns its inputs can be scored.
    replayed = recorded._replace(samples=rows._replace(inputs=np.stack(predicted).astype(np.float32)))
    echo = Predictor(lambda context: np.zeros(()), lambda state, x, time: x)
    scores = scoring.score(echo, replayed, scale, fit_samples, roll_outs=False)
    return scores | {name: np.array([e[name] for e in ends]) for name in ends[0]}


def accelerations(
    condition: Mapping[str, Any],
    inputs: np.ndarray,
    poses: np.ndarray,
    runs: np.ndarray,
    *,
    starts: Collection[int] = (),
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Accelerations of the object alone in C MuJoCo, sample by sample, and roll-outs.

    Each sample starts from the recorded planar pose and twist. Wheels and casters are not recorded. They continue from
    the sample before, or start from the angles of the condition at the start of an episode.

    Args:
        condition: properties of the recorded object.
        inputs: ``[N, 13]`` as OBJECT_INPUTS lists them.
        poses: ``[N, 3]`` poses of the object in {W}.
        runs: ``[N]`` number of rows left in the episode.
        starts: rows from which the object is also rolled out, driven only by the recorded wrenches in {O}.

    Returns:
        Accelerations ``[N, 3]`` in {O} over each sample, and for each start the poses ``[H + 1, 3]`` in {W}, where H is
        the longest of `scoring.HORIZONS`.
    """
    names = {f.name for f in fields(Condition)}
    spec = mujoco.MjSpec.from_file(str(asset("models_xml/scene.xml")))
    one = Condition.from_dict({key: value for key, value in condition.items() if key in names})
    spec.attach(object_spec(one), prefix="object/", frame=spec.worldbody.add_frame())
    model = spec.compile()
    data, body = mujoco.MjData(model), model.body("object/object").id
    where = features.slices(features.OBJECT_INPUTS)
    wrenches, longest = inputs[:, where["wrench"]], max(scoring.HORIZONS.values())
    one_step, rolled = np.zeros((len(inputs), 3)), {}
    for i, (row, pose) in enumerate(zip(inputs, poses, strict=True)):
        if i == 0 or runs[i] != runs[i - 1] - 1:
            mujoco.mj_resetData(model, data)
            mujoco.mj_step(model, data, round(SETTLE / model.opt.timestep))
            height = data.qpos[2]
        twist = se2.rotate(row[where["object_twist"]], pose[2])
        data.qpos[:7] = [*pose[:2], height, np.cos(pose[2] / 2), 0.0, 0.0, np.sin(pose[2] / 2)]
        data.qvel[:6] = [*twist[:2], 0.0, 0.0, 0.0, twist[2]]
        mujoco.mj_forward(model, data)
        if i in starts:
            before = data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy()
            rolled[i] = np.array([pose, *(_pushed(model, data, body, w) for w in wrenches[i : i + longest])])
            data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = before
            mujoco.mj_forward(model, data)
        _pushed(model, data, body, row[where["wrench"]])
        one_step[i] = se2.rotate((data.qvel[[0, 1, 5]] - twist) / DT, -pose[2])
    return one_step, rolled


def _pushed(model: mujoco.MjModel, data: mujoco.MjData, body: int, wrench: np.ndarray) -> np.ndarray:
    """Push the object for one sample and return its planar pose ``[3]`` in {W}.

    The wrench ``[3]`` is given in {O} at the start of the sample. Its direction in {W} then stays constant.
    """

    def pose() -> np.ndarray:
        return np.array([*data.qpos[:2], 2 * np.arctan2(data.qpos[6], data.qpos[3])])

    turned = se2.rotate(wrench, pose()[2])
    push = np.array([*turned[:2], 0.0])
    for _ in range(round(DT / model.opt.timestep)):
        lever = np.array([*data.xpos[body][:2], HAND_HEIGHT]) - data.xipos[body]
        data.xfrc_applied[body, :3], data.xfrc_applied[body, 3:] = push, np.cross(lever, push)
        data.xfrc_applied[body, 5] += wrench[2]
        mujoco.mj_step(model, data)
    return pose()


def _ends(starts: Mapping[int, list[int]], rolled: Mapping[int, np.ndarray], poses: np.ndarray) -> dict[str, float]:
    """Root mean squared errors at the end of each horizon, as in `scoring`. NaN without a roll-out."""
    ends = {}
    for name, h in scoring.HORIZONS.items():
        error = np.array(
            [se2.relative(poses[s], rolled[s][h]) - se2.relative(poses[s], poses[s + h]) for s in starts[h]]
        )
        error = error.reshape(-1, 3)
        some = len(error) > 0
        ends[f"pos_rmse_{name}_m"] = np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))) if some else np.nan
        ends[f"yaw_rmse_{name}_deg"] = np.rad2deg(np.sqrt(np.mean(se2.wrap(error[:, 2]) ** 2))) if some else np.nan
    return ends
