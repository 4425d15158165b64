"""The 3-D film: size, what is drawn at which time, and that marks lie where the camera sees their places."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.render import Mark, can_render, shots, tops
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.report import film
from shmoo_mjx.report.trace import Trace

WHY = can_render()
needs_renderer = pytest.mark.skipif(bool(WHY), reason=WHY)


@pytest.fixture(scope="module")
def scene() -> Scene:
    objects = [
        (draw_condition(family, 3), pose)
        for family, pose in (("box", (3.2, 1.5, 0.1)), ("wheelchair", (5.8, 3.4, 1.1)))
    ]
    return build_scene(objects, (1.0, 1.2, 0.0), [(3.5, 2.65, 1.5, 0.15)])


def placed(scene: Scene, trace: Trace) -> np.ndarray:
    poses = zip(trace.robot_pose, trace.object_pose, strict=True)
    return np.array([scene.placed(robot, objects) for robot, objects in poses])


@needs_renderer
def test_a_film_is_720p_and_shows_every_sample_at_three_times_the_speed(
    scene: Scene, trace: Trace, result: dict[str, Any]
) -> None:
    first: dict[str, Any] = {
        name: value[:8]
        for name, value in trace._asdict().items()
        if isinstance(value, np.ndarray) and len(value) == 400
    }
    short = trace._replace(**first)
    frames = list(film.film_frames(result, short, scene, placed(scene, short), speed=3.0))
    assert len(frames) == 8 + round(film.FPS * film._HOLD)
    assert {frame.shape for frame in frames} == {(720, 1280, 3)}


@needs_renderer
def test_a_mark_lies_where_the_camera_sees_its_place(scene: Scene) -> None:
    place = (0.4, 1.0, 0.01)
    mark = Mark("disc", place, place, 0.05, (1.0, 0.0, 1.0, 1.0))
    (shot,) = shots(scene, scene.qpos0[None], width=320, height=240, marks=lambda i, hands: [mark])
    red, green, blue = np.moveaxis(shot.image.astype(int), -1, 0)
    rows, columns = np.nonzero(np.minimum(red, blue) - green > 80)
    np.testing.assert_allclose(shot.pixels(place), [columns.mean() + 0.5, rows.mean() + 0.5], atol=1.0)
    behind = shot.eye - 3.0 * shot.axes[2]
    assert np.isnan(shot.pixels(behind)).all()


@needs_renderer
def test_walls_stand_out_from_the_floor_and_the_wheelchair_is_solid(scene: Scene) -> None:
    (shot,) = shots(scene, scene.placed((2.5, 0.5, 0.0), [(3.2, 1.5, 0.1), (3.6, 0.4, 1.1)])[None])

    def brightness(*place: float) -> float:
        column, row = shot.pixels(place).astype(int)
        return float(shot.image[row, column].mean())

    assert brightness(2.4, 2.5, 0.3) < 0.7 * brightness(2.4, 2.0, 0.0)
    assert film.tops(scene)[1] > 0.8


def test_what_is_drawn_at_which_time(scene: Scene, trace: Trace, result: dict[str, Any]) -> None:
    drawn, hands = film._Drawn(result, trace, tops(scene)), np.array([[3.0, 1.3, 0.6], [3.0, 1.7, 0.6]])

    def kinds(t: float) -> list[str]:
        return [mark.kind for mark in drawn.marks(round(10 * t), hands)]

    assert kinds(5.0).count("ribbon") == 2 and "arrow" not in kinds(5.0)  # plan and goal
    assert kinds(15.0).count("arrow") == 1 and kinds(15.0).count("ribbon") > 100  # predicted pushes, too
    (arrow,) = (mark for mark in drawn.marks(150, hands) if mark.kind == "arrow")
    force, along = trace.force[150], np.subtract(arrow.b, arrow.a)
    assert np.linalg.norm(along) == pytest.approx(film._PER_NEWTON * np.linalg.norm(force))
    told = [line for label in drawn.labels(190) for line in label.lines]
    assert "goal" in told and "box" in told and any(line.endswith("kg, true 6") for line in told)
    assert "can't be moved" not in told
    assert "can't be moved" in [line for label in drawn.labels(350) for line in label.lines]


def test_an_object_that_is_pushed_to_a_pose_has_its_goal_in_the_scene(
    scene: Scene, trace: Trace, result: dict[str, Any]
) -> None:
    target = [5.0, 2.0, 0.3]
    drawn = film._Drawn(
        {**result, "push_to": target, "decisions": []}, trace._replace(plans=(), plan_times=np.zeros(0)), tops(scene)
    )
    ribbons = [mark for mark in drawn.marks(0, np.zeros((2, 3))) if mark.kind == "ribbon"]
    np.testing.assert_allclose(np.mean([mark.a for mark in ribbons[:4]], axis=0)[:2], target[:2], atol=1e-6)
    assert any(label.lines == ("goal of the box",) for label in drawn.labels(0))
