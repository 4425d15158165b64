"""Time of a run by part. The time of a part excludes that of the parts inside it, so the times add up."""

from __future__ import annotations

import functools
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

PARTS = {
    "physics": ("shmoo_mjx.plant.engine_mujoco:MujocoEngine._hold",),
    "low-level control, 500 Hz": ("shmoo_mjx.plant.engine_mujoco:MujocoEngine._asked",),
    "senses": ("shmoo_mjx.sensing.engine:SensedEngine.step",),
    "MPPI and adaptation": (
        "shmoo_mjx.control.pushing:PushController.step",
        "shmoo_mjx.control.pushing:PushController.coast",
        "shmoo_mjx.control.pushing:PushController.planning_rollouts",
        "shmoo_mjx.control.pushing:PushController.compile",
    ),
    "where pushes lead": ("shmoo_mjx.behavior.push_options:predict_pushes",),
    "global paths": ("shmoo_mjx.planning.paths:plan_path", "shmoo_mjx.planning.paths:cost_to_go"),
    "local trajectories": ("shmoo_mjx.planning.flat_trajectory:plan",),
    "navigator, the rest": ("shmoo_mjx.behavior.navigator:Navigator.tick",),
    "film": ("shmoo_mjx.run.scenario_run:_write_video",),
    "report and files": (
        "shmoo_mjx.run.scenario_run:save_run",
        "shmoo_mjx.run.recording:save_recording",
        "shmoo_mjx.report.html:write_report",
    ),
}
"""Functions whose time counts for each part."""
COMPILATION = "tracing and compilation"


@dataclass
class PartClock:
    """Measures the time of each part [s], without that of the parts inside it."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    inside: list[float] = field(default_factory=lambda: [0.0])
    """Time spent so far in the parts inside each part that is being run, the innermost last [s]."""

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function`` with its time counted for ``part``."""

        @functools.wraps(function)
        def counted(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            self.inside.append(0.0)
            try:
                return function(*args, **kwargs)
            finally:
                took = time.perf_counter() - began
                self.seconds[part] += took - self.inside.pop()
                self.inside[-1] += took

        return counted

    def add(self, part: str, seconds: float) -> None:
        """Count ``seconds`` that have just passed for ``part``, and not for the part that is being run."""
        self.seconds[part] += seconds
        self.inside[-1] += seconds


def watch(clock: PartClock) -> None:
    """Wrap the functions of PARTS in all modules that name them, and count the compilations of JAX."""
    import importlib

    import jax

    for part, places in PARTS.items():
        for place in places:
            module, _, name = place.partition(":")
            owner: Any = importlib.import_module(module)
            *classes, name = name.split(".")
            for kind in classes:
                owner = getattr(owner, kind)
            function = getattr(owner, name)
            counted = clock.timed(part, function)
            setattr(owner, name, counted)
            for other in [m for key, m in sys.modules.items() if key.startswith("shmoo_mjx")]:
                for key in [k for k, v in vars(other).items() if v is function]:
                    setattr(other, key, counted)

    def heard(event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith("/jax/core/compile/"):
            clock.add(COMPILATION, duration_secs)

    jax.monitoring.register_event_duration_secs_listener(heard)
