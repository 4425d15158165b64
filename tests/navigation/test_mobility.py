"""The probability that an object can be moved."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from shmoo_mjx.navigation.mobility import probability

WAYS, IMPULSES = st.floats(0.0, 5.0), st.floats(0.0, 5000.0)


@given(WAYS, IMPULSES, st.floats(0.01, 1.0), st.floats(1.0, 100.0))
def test_it_grows_with_the_way_and_falls_with_the_impulse(
    moved: float, impulse: float, more: float, spent: float
) -> None:
    p = probability(moved, impulse)
    assert 0.0 <= p <= 1.0
    assert probability(moved + more, impulse) >= p >= probability(moved, impulse + spent)


def test_it_is_sure_of_what_has_gone_and_of_what_held_and_not_of_what_was_hardly_touched() -> None:
    assert probability(0.2, 15.0) > 0.95
    assert probability(0.0, 60.0) < 0.05
    assert 0.05 < probability(0.0, 8.0) < 0.95
