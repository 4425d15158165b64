"""A mirror image is what would have been recorded with left and right exchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.data.mirror import mirrored, mirrored_condition
from shmoo_mjx.dynamics import features
from shmoo_mjx.dynamics.features import OBJECT_INPUTS, ROBOT_INPUTS, slices
from shmoo_mjx.learning import robot_fit, samples
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import draw_condition

ODD = {"base_twist": (1, -1, -1), "lean": (1, -1), "lean_rate": (1, -1), "face_pose": (1, -1, -1)}
ODD |= {"relative_twist": (1, -1, -1), "last_force": (1, -1), "last_u": (1, -1, -1), "u": (1, -1, -1)}
ODD |= {
    "object_twist": (1, -1, -1),
    "wrench": (1, -1, -1),
    "last_object_twist": (1, -1, -1),
    "last_wrench": (1, -1, -1),
}
HANDS = {"gap": 1, "offset": -1, "gap_rate": 1}
"""What is told of the left and the right hand: they change places."""


@pytest.fixture(scope="module")
def recordings() -> store.Dataset:
    """Three conditions of two episodes with 30 samples of anything."""
    rng, arrays = np.random.default_rng(0), []
    for _ in range(3):
        of = {name: rng.normal(scale=0.3, size=(2, 30, *shape)) for name, shape in store.FIELDS.items()}
        of |= {"contact": of["contact"] > 0, "face": rng.normal(size=(2, 4)), "size": rng.uniform(0.3, 0.6, 2)}
        of["face"][:, 3] = 0.3
        arrays.append({name: v if v.dtype == bool else v.astype(np.float32) for name, v in of.items()})
    return store.Dataset(["a", "b", "c"], [{"split": "train"}] * 3, arrays, {})


def in_the_mirror(inputs: np.ndarray, table: tuple[features.Entry, ...]) -> np.ndarray:
    out = inputs.copy()
    for name, where in slices(table).items():
        if name in HANDS:
            out[..., where] = HANDS[name] * inputs[..., where][..., ::-1]
        elif name in ODD:
            out[..., where] = inputs[..., where] * ODD[name]
    return out


def test_inputs_and_labels_of_a_mirror_image_are_those_of_the_original_in_the_mirror(
    recordings: store.Dataset,
) -> None:
    both = recordings.with_mirror_images()
    count = len(recordings.arrays)
    assert (
        len(both.arrays) == len(both.names) == len(both.conditions) == 2 * count and len(set(both.names)) == 2 * count
    )
    found = samples.samples_from_dataset(both)
    np.testing.assert_allclose(found.inputs[count:], in_the_mirror(found.inputs[:count], OBJECT_INPUTS), atol=1e-4)
    np.testing.assert_allclose(found.labels[count:], found.labels[:count] * (1, -1, -1), atol=1e-3)
    np.testing.assert_array_equal(found.weights[count:], found.weights[:count])
    robot = robot_fit.samples_from_dataset(both)
    half = len(robot.inputs) // 2
    np.testing.assert_allclose(robot.inputs[half:], in_the_mirror(robot.inputs[:half], ROBOT_INPUTS), atol=1e-4)
    np.testing.assert_allclose(robot.labels[half:], robot.labels[:half] * (1, -1, -1, 1, -1), atol=1e-3)


def test_twice_mirrored_is_the_original(recordings: store.Dataset) -> None:
    for arrays in recordings.arrays:
        for name, values in mirrored(mirrored(arrays)).items():
            np.testing.assert_array_equal(values, arrays[name])
            assert values.dtype == arrays[name].dtype


def test_what_is_told_of_an_object_is_mirrored_too() -> None:
    chair = draw_condition("wheelchair", 5, {"payload_y": 0.05, "locked": (True, False, False, False)})
    image = mirrored_condition(chair.to_dict() | {"split": "train"})
    assert image["payload_y"] == -0.05 and image["locked"] == [False, True, False, False]
    assert image["rolling"][0] == chair.rolling[1] and image["rolling"][3] == chair.rolling[2]
    assert image["caster_angle"] == [-chair.caster_angle[1], -chair.caster_angle[0]]
    assert Condition.from_dict({k: v for k, v in mirrored_condition(image).items() if k != "split"}) == chair


def test_images_of_images_are_not_made(recordings: store.Dataset) -> None:
    both = recordings.with_mirror_images()
    assert both.with_mirror_images() is both


def test_every_array_of_a_recording_has_its_mirror_image(recordings: store.Dataset) -> None:
    assert set(mirrored(recordings.arrays[0])) == {*store.FIELDS, "face", "size"}


def test_the_simulated_world_is_the_same_in_the_mirror(tmp_path: Path) -> None:
    """The same push at a mirrored box, in C MuJoCo: what the training takes for granted."""
    pytest.importorskip("mujoco")
    from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
    from shmoo_mjx.plant.engine_mujoco import MujocoEngine
    from shmoo_mjx.plant.objects import draw_condition
    from shmoo_mjx.plant.scene import build_scene
    from shmoo_mjx.types import Command

    def pushed(side: float) -> np.ndarray:
        size = {"size": (0.5, 0.5, 0.6), "mass": 6.0, "payload": 4.0, "payload_x": 0.0, "payload_y": side * 0.12}
        box = draw_condition("box", 0, size | {"friction": 0.3})
        engine = MujocoEngine([build_scene([(box, (0.9, side * 0.05, side * 0.1))])])
        world, poses = engine.init(), []
        for i in range(40):
            u = np.array([[0.05 * (i > 8), side * 0.01, side * 0.1]])
            wanted = Command(u, np.zeros(1), np.array([REACH]), np.array([HAND_HEIGHT]))
            world, seen = engine.step(world, wanted)
            poses.append(seen.object_pose[0, 0])
        engine.close()
        return np.array(poses)

    left, right = pushed(1.0), pushed(-1.0)
    assert np.linalg.norm(left[-1, :2] - left[0, :2]) > 0.1 and abs(left[-1, 2] - left[0, 2]) > 0.02
    np.testing.assert_allclose(right * (1, -1, -1), left, atol=0.01)
