"""Mirror images of recordings, with left and right exchanged, for data augmentation.

Robot and floor are symmetric, so a mirrored recording is a valid recording of the mirrored object. Training on both
removes a left-right bias: otherwise a learner picks up the random asymmetry of the objects' loads and steers against
it. R and psi are equivariant by construction (`dynamics.networks`). The baselines' networks and the prior of bodies are
not.
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
"""Signs of the last axis of each array under mirroring: y components and rotations change their sign."""


def mirrored(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Mirror a condition's arrays (`store.FIELDS`, face and size) at the x-z plane."""
    return {
        name: values if set(_SIGNS[name]) == {1} else values * np.array(_SIGNS[name], dtype=values.dtype)
        for name, values in arrays.items()
    }


def mirrored_condition(condition: dict[str, Any]) -> dict[str, Any]:
    """Mirror a condition as stored in the manifest. Wheels are ordered in pairs of left and right."""
    new = dict(condition)
    if "payload_y" in new:
        new["payload_y"] = -new["payload_y"]
    for name in ("rolling", "locked", "caster_angle"):
        if values := list(new.get(name, ())):
            swapped = [value for pair in zip(values[1::2], values[::2], strict=True) for value in pair]
            new[name] = [-angle for angle in swapped] if name == "caster_angle" else swapped
    return new
