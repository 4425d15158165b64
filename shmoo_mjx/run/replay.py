"""Replay: feeds the recorded observations of a run to the navigator and compares the commands bit for bit.

On another processor or with other versions the commands may differ. The first differing sample then shows where to
look.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from shmoo_mjx.behavior.interaction import Machine
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.report.trace import load_result
from shmoo_mjx.run.recording import RECORDING_FILE, Recording, load_recording
from shmoo_mjx.run.scenario_run import OWN_WEIGHTS
from shmoo_mjx.run.simulation import navigator_of
from shmoo_mjx.types import Command, Observation


class Difference(NamedTuple):
    """The first sample at which a replay gives another command."""

    sample: int
    """Index of the sample."""
    time: float
    """Time of the sample [s]."""
    state: str
    """Mode of the navigator."""
    field: str
    """Field of the command that differs."""
    recorded: np.ndarray
    """Value of the field in the recording."""
    replayed: np.ndarray
    """Value of the field in the replay."""

    def __str__(self) -> str:
        values = f"{np.round(self.recorded, 6).tolist()} recorded, {np.round(self.replayed, 6).tolist()} now"
        return f"sample {self.sample} ({self.time:.1f} s, {self.state}): {self.field} differs: {values}"


def replay(run: Path, weights: Path | None = None) -> Difference | None:
    """The first command that differs when this version's navigator replays the recording in folder ``run``, or None.

    Args:
        run: folder of the run.
        weights: weights file; by default the one in the folder, or else that of the run's method.

    Raises:
        ShmooError: a file is missing, damaged or from another version, or the run was made with other weights.
    """
    from shmoo_mjx.behavior.methods import method_named
    from shmoo_mjx.behavior.settings import with_settings
    from shmoo_mjx.planning.maps import load_map
    from shmoo_mjx.planning.scenario import load_scenario
    from shmoo_mjx.sensing import senses_named

    result, recorded = load_result(run / "result.json"), load_recording(run / RECORDING_FILE)
    own = run / OWN_WEIGHTS
    method = with_settings(method_named(str(result.get("method", "ours"))), result.get("settings", ()))
    scenario = load_scenario(run / "scenario.yaml")
    to_pose = scenario.push_to is not None
    controller = method.controller(weights or (own if own.is_file() else None), to_pose)
    if result.get("weights") != controller.weights.info:
        raise ShmooError(f"{run}: the run was made with other weights; give them with --weights.")
    senses = senses_named(str(result.get("senses")))
    navigator = navigator_of(
        load_map(run / "map.yaml"), scenario, controller, senses, config=method.navigator, policy=result.get("policy")
    )
    return differences(navigator, recorded)


def differences(navigator: Machine, recorded: Recording) -> Difference | None:
    """The first sample at which ``navigator``, in its initial state, gives another command than the recorded one."""
    for i, time in enumerate(recorded.observations.time[:, 0]):
        if i and not np.array_equal(recorded.goals[i], recorded.goals[i - 1]):
            navigator.head_for(recorded.goals[i], float(time))
        command = navigator.tick(Observation(*(np.asarray(field)[i] for field in recorded.observations)))
        for name, then, now in zip(Command._fields, recorded.commands, command, strict=True):
            before = np.asarray(then)[i]
            if not np.array_equal(before, now):
                return Difference(i, float(time), str(navigator.mode), name, before, np.asarray(now))
    return None
