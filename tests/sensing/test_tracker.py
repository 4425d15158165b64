"""The tracks: noise is filtered, lost objects come to rest, false jumps are held back, real ones believed."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.sensing import tracker
from shmoo_mjx.sensing.tracker import TrackerConfig, Tracks

CONFIG = TrackerConfig()
FRAME = 1 / 30
SPREAD = np.full((1, 1, 3), 0.003)


def feed(
    tracks: Tracks, poses: list[tuple[float, float, float] | None], start: int = 0, noise: float = 0.0
) -> tuple[Tracks, list[Tracks]]:
    """Frames with these detections; None where there is none."""
    rng, history = np.random.default_rng(0), []
    for i, pose in enumerate(poses):
        found = np.array([[pose is not None]])
        measured = np.array([[pose or (0.0, 0.0, 0.0)]]) + noise * rng.normal(size=(1, 1, 3))
        at = np.array([float(start + i) * FRAME * 100])
        tracks = tracker.update(
            CONFIG, tracks, measured, SPREAD, detected=found, seconds=np.array([FRAME]), time=(at, at + 3)
        )
        history.append(tracks)
    return tracks, history


def test_never_detected_is_nan() -> None:
    tracks, _ = feed(tracker.init(1, 1), [None] * 5)
    assert np.isnan(tracks.pose).all() and not tracker.ever_detected(tracks).any()
    assert np.isinf(tracks.detected_at).all()


def test_a_resting_object_is_known_better_than_one_frame_tells() -> None:
    _, history = feed(tracker.init(1, 1), [(1.0, 2.0, 0.3)] * 300, noise=0.003)
    error = np.array([t.pose[0, 0] for t in history[30:]]) - (1.0, 2.0, 0.3)
    assert error.std() < 0.8 * 0.003
    assert np.std([t.rate[0, 0, 0] for t in history[30:]]) < 0.04


def test_a_moving_object_is_followed() -> None:
    way = [(0.3 * i * FRAME, 0.0, 0.0) for i in range(60)]
    tracks, _ = feed(tracker.init(1, 1), way)
    np.testing.assert_allclose(tracks.rate[0, 0], (0.3, 0.0, 0.0), atol=0.01)
    np.testing.assert_allclose(tracker.ahead(tracks, np.array([0.05]))[0, 0, 0], way[-1][0] + 0.015, atol=2e-3)


def test_a_lost_object_is_carried_on_and_comes_to_rest() -> None:
    way: list = [(0.3 * i * FRAME, 0.0, 0.0) for i in range(60)]
    tracks, history = feed(tracker.init(1, 1), [*way, *[None] * 60])
    assert tracks.pose[0, 0, 0] - way[-1][0] == np.clip(tracks.pose[0, 0, 0] - way[-1][0], 0.06, 0.12)
    assert abs(tracks.rate[0, 0, 0]) < 1e-3
    assert tracks.detected_at[0, 0] == history[59].detected_at[0, 0]


def test_a_false_jump_is_held_back_and_a_real_one_believed() -> None:
    here, there = (1.0, 0.0, 0.0), (1.5, 0.2, 0.4)
    tracks, _ = feed(tracker.init(1, 1), [here] * 30)
    once, _ = feed(tracks, [there, here, here], 30)
    np.testing.assert_allclose(once.pose[0, 0], here, atol=0.01)
    # Two false detections at different places don't add up.
    twice, _ = feed(tracks, [there, (0.2, 0.0, 0.0), (2.5, 1.0, 1.0)], 30)
    np.testing.assert_allclose(twice.pose[0, 0], here, atol=0.01)
    _, history = feed(tracks, [there] * 4, 30)
    assert [abs(t.pose[0, 0, 0] - 1.5) < 0.01 for t in history] == [False, False, True, True]
    assert np.abs(history[2].rate).max() < 1e-9
    assert [t.detected_at[0, 0] > tracks.detected_at[0, 0] for t in history] == [False, False, True, True]


def test_what_was_moved_out_of_sight_is_believed_at_once_and_rests() -> None:
    tracks, _ = feed(tracker.init(1, 1), [*[(1.0, 0.0, 0.0)] * 30, *[None] * 90])
    tracks, _ = feed(tracks, [(2.0, 0.5, 0.1)], 120)
    np.testing.assert_allclose(tracks.pose[0, 0], (2.0, 0.5, 0.1))
    assert np.abs(tracks.rate).max() < 1e-9


def test_yaw_goes_round() -> None:
    way = [(0.0, 0.0, float(np.pi - 0.3 + 0.5 * i * FRAME)) for i in range(60)]
    tracks, history = feed(tracker.init(1, 1), [(x, y, (a + np.pi) % (2 * np.pi) - np.pi) for x, y, a in way])
    assert all(abs(t.pose[0, 0, 2]) <= np.pi for t in history)
    np.testing.assert_allclose(tracks.rate[0, 0, 2], 0.5, atol=0.02)


def test_a_world_without_a_frame_stays_as_it_is() -> None:
    tracks, _ = feed(tracker.init(1, 1), [(0.1 * i * FRAME, 0.0, 0.0) for i in range(10)])
    none = np.array([[False]])
    zero = np.zeros(1)
    same = tracker.update(
        CONFIG, tracks, np.ones((1, 1, 3)), SPREAD, detected=none, seconds=zero, time=(tracks.at + 1, tracks.at + 4)
    )
    for name in Tracks._fields:
        np.testing.assert_allclose(getattr(same, name), getattr(tracks, name), atol=1e-15, err_msg=name)
