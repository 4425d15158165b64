"""Faces that are pushed: what hands that stand at a corner touch. Of the sides, tests/navigation has the rest."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import corners_of, faces_of, heading, stand_off
from shmoo_mjx.geometry.hands import HAND_RADIUS, hand_targets
from shmoo_mjx.planning.footprints import footprint_polygon

HALF_EXTENT = st.floats(0.2, 0.6)


@settings(max_examples=30, deadline=None)
@given(HALF_EXTENT, HALF_EXTENT, st.floats(-3.0, 3.0), st.integers(0, 3))
def test_hands_at_a_corner_touch_a_side_each(a: float, b: float, yaw: float, corner: int) -> None:
    pose = np.array([1.0, -2.0, yaw])
    robot = stand_off(pose, corners_of((a, b))[corner], gap=0.0)
    box = footprint_polygon(pose, (a, b))
    hands = [shapely.Point(se2.transform_point(robot, hand)) for hand in hand_targets(0.0)]
    assert [box.exterior.distance(hand) for hand in hands] == pytest.approx([HAND_RADIUS] * 2)
    assert not any(box.contains(hand) for hand in hands)


def test_a_corner_is_pushed_halfway_between_the_directions_of_its_sides() -> None:
    pose, half = np.array([0.0, 0.0, 0.3]), (0.4, 0.3)
    sides, corners = (heading(pose, faces) for faces in (faces_of(half), corners_of(half)))
    for i in range(4):
        assert np.cos(corners[i] - sides[[i, (i + 1) % 4]]) == pytest.approx([np.sqrt(0.5)] * 2)
