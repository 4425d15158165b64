"""Mirror images of recordings: what happened, seen with left and right exchanged.

Robot and floor are the same on both sides, so that a mirrored recording is one that could have been made, of the
mirrored object. A learner that sees both has no reason to prefer a side; one that doesn't takes the chance
preponderance of some objects' loads for a law, and steers against it. R and psi have no side by their form
(`dynamics.equivariant`); the baselines' networks and the prior of bodies have not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_SIGNS = {
    "robot_pose": (1, -1, -1),
    "robot_twist": (1, -1, -1),
    "lean": (1, -1),
    "lean_rate": (1, -1),
    "object_pose": (1, -1, -1),
    "object_twist": (1, -1, -1),
    "u": (1, -1, -1),
    "force_robot": (1, -1),
    "wrench_object": (1, -1, -1),
    "contact": (1,),
    "face": (1, -1, -1, 1),
    "size": (1,),
}
"""Of the last axis of each array of a recording: y and what turns change their sign."""


def mirrored(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A condition's arrays (`store.FIELDS`, face and size) in the mirror of the x-z plane."""
    return {
        name: values if set(_SIGNS[name]) == {1} else values * np.array(_SIGNS[name], dtype=values.dtype)
        for name, values in arrays.items()
    }


def mirrored_condition(condition: dict[str, Any]) -> dict[str, Any]:
    """What the manifest tells of an object, of its mirror image: wheels come in pairs of a left and a right one."""
    new = dict(condition)
    if "payload_y" in new:
        new["payload_y"] = -new["payload_y"]
    for name in ("rolling", "locked", "caster_angle"):
        if values := list(new.get(name, ())):
            swapped = [value for pair in zip(values[1::2], values[::2], strict=True) for value in pair]
            new[name] = [-angle for angle in swapped] if name == "caster_angle" else swapped
    return new
