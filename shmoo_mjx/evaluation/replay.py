"""What a recording leaves to be predicted: the plant itself, told everything, pushed by each sample's mean wrench.

A predictor sees a sample's mean planar wrench. The hands' forces vary within the sample and pull up or down on the
face, and the object sags and tips a little; none of that is among psi's inputs. So even the simulator with the true
object misses some of the acceleration, and no predictor of the comparison can be expected to miss less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.assets import asset
from shmoo_mjx.data import store
from shmoo_mjx.dynamics import features
from shmoo_mjx.evaluation import scoring
from shmoo_mjx.hands import HAND_HEIGHT
from shmoo_mjx.learning.baselines import Predictor, recordings
from shmoo_mjx.plant.objects import Condition, object_spec
from shmoo_mjx.types import DT

__all__ = ["accelerations", "score"]

SETTLE = 0.4
"""Time for the object to sink into its contacts before a recording is replayed [s]."""


def score(objects: store.Dataset, scale: np.ndarray, fit_rows: int = scoring.FIT_ROWS) -> dict[str, np.ndarray]:
    """The one-step measures of `scoring` ``[C]`` of the replay, on the rows after ``fit_rows``."""
    recorded = recordings(objects)
    predicted = [
        accelerations(condition, rows, poses, runs)
        for condition, rows, poses, runs in zip(
            objects.conditions, recorded.rows.inputs, recorded.pose, recorded.rows.run, strict=True
        )
    ]
    # The replay stands in for the inputs: a predictor that says what its inputs say is scored like any other.
    said = recorded._replace(rows=recorded.rows._replace(inputs=np.stack(predicted).astype(np.float32)))
    told = Predictor(lambda context: np.zeros(()), lambda state, x, time: x)
    return scoring.score(told, said, scale, fit_rows, roll_outs=False)


def accelerations(condition: Mapping[str, Any], inputs: np.ndarray, poses: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """Accelerations ``[N, 3]`` in {O} over each recorded sample, as C MuJoCo has them for the object alone.

    Each sample starts from the recorded planar pose and twist. What isn't recorded, wheels and casters, goes on from
    the sample before, and from the condition's starting angles where an episode starts.

    Args:
        condition: of the recording.
        inputs: ``[N, 10]`` as OBJECT_INPUTS lists them.
        poses: ``[N, 3]`` of the object in {W}.
        runs: ``[N]`` rows left in the episode.
    """
    known = {f.name for f in fields(Condition)}
    spec = mujoco.MjSpec.from_file(str(asset("models_xml/scene.xml")))
    one = Condition.from_dict({key: value for key, value in condition.items() if key in known})
    spec.attach(object_spec(one), prefix="object/", frame=spec.worldbody.add_frame())
    model = spec.compile()
    data, body = mujoco.MjData(model), model.body("object/object").id
    where = features.slices(features.OBJECT_INPUTS)
    steps = round(DT / model.opt.timestep)
    found = np.zeros((len(inputs), 3))
    for i, (row, pose) in enumerate(zip(inputs, poses, strict=True)):
        if i == 0 or runs[i] != runs[i - 1] - 1:
            mujoco.mj_resetData(model, data)
            mujoco.mj_step(model, data, round(SETTLE / model.opt.timestep))
            height = data.qpos[2]
        twist, wrench = (se2.rotate(row[where[name]], pose[2]) for name in ("object_twist", "wrench"))
        data.qpos[:7] = [*pose[:2], height, np.cos(pose[2] / 2), 0.0, 0.0, np.sin(pose[2] / 2)]
        data.qvel[:6] = [*twist[:2], 0.0, 0.0, 0.0, twist[2]]
        mujoco.mj_forward(model, data)
        push = np.array([*wrench[:2], 0.0])
        for _ in range(steps):
            lever = np.array([*data.xpos[body][:2], HAND_HEIGHT]) - data.xipos[body]
            data.xfrc_applied[body, :3], data.xfrc_applied[body, 3:] = push, np.cross(lever, push)
            data.xfrc_applied[body, 5] += wrench[2]
            mujoco.mj_step(model, data)
        found[i] = se2.rotate((data.qvel[[0, 1, 5]] - twist) / DT, -pose[2])
    return found
