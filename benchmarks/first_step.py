"""Time to the first commands of the demo, in a process of its own: python -m benchmarks.first_step SEED.

Prints one line of JSON: seconds from the start of this file to the first command (``drive``), and to the first command
of MPPI (``push``). The second time includes the simulation of the drive to the box.
"""

from __future__ import annotations

import time

_BEGAN = time.perf_counter()


def main() -> None:
    """Run the demo until it pushes."""
    from shmoo_mjx.base.environment import prepare_environment

    prepare_environment()
    import json
    import sys

    from shmoo_mjx.base.assets import WEIGHTS, asset
    from shmoo_mjx.control.pushing import PushController
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.planning.floorplan import demo_scenario
    from shmoo_mjx.run.episode import Hooks, run_episode

    seconds: dict[str, float] = {}

    def note(now: float, mode: str) -> None:
        kind = "push" if mode == "probe" else "drive"
        seconds.setdefault(kind, time.perf_counter() - _BEGAN)

    controller = PushController(load_weights(asset(WEIGHTS)))
    run_episode(*demo_scenario(int(sys.argv[1])), controller, hooks=Hooks(note, over=lambda _: "push" in seconds))
    print(json.dumps(seconds))


if __name__ == "__main__":
    main()
