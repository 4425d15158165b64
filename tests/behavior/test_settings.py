"""Settings of a run by name reach the method's configurations, and what is no setting is refused."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from shmoo_mjx.base.options import METHODS as NAMES
from shmoo_mjx.base.options import parted
from shmoo_mjx.behavior.methods import METHODS, OURS
from shmoo_mjx.behavior.settings import settings_of, with_settings
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.condition import Condition


def test_the_command_line_knows_every_method() -> None:
    assert tuple(METHODS) == NAMES


def test_a_setting_changes_its_field_alone() -> None:
    method = METHODS[OURS]
    changed = with_settings(method, ["control.num_rollouts=128", "navigator.decides_by=K", "pushing.adapts=false"])
    for before, after in ((method.pushing, changed.pushing), (method.pose_pushing, changed.pose_pushing)):
        assert after == replace(before, control=replace(before.control, num_rollouts=128), adapts=False)
    assert changed.navigator == replace(method.navigator, decides_by="K")
    assert with_settings(method, []) == method


def test_every_setting_takes_its_own_value() -> None:
    method = METHODS[OURS]
    for name, value in settings_of(method).items():
        text = str(list(value)) if isinstance(value, tuple) else str(value).lower() if value in (True, False) else value
        same = with_settings(method, [f"{name}={text}"])
        assert settings_of(same) == settings_of(method), name


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("control.num_rollouts", "NAME=VALUE"),
        ("control.rollouts=3", "did you mean control.num_rollouts?"),
        ("governor.qqq=3", "governor.gain"),
        ("thing.size=3", "control., cost."),
        ("mass=3", "scenario file"),
        ("control.horizon=long", "integer"),
        ("control.horizon=0", "control.horizon"),
        ("control.horizon=100000", "from 1 to 1000"),
        ("control.num_rollouts=2", "from 3 to 100000"),
        ("control.num_rollouts=10000000", "from 3 to 100000"),
        ("control.low=[-1, -1]", "2 entries"),
        ("cost.aim_weight=.nan", "finite"),
        ("cost.aim_weight=-1", "at least 0"),
        ("navigator.decides_by=Z", "'time' or 'K'"),
    ],
)
def test_what_is_no_setting_is_refused(text: str, told: str) -> None:
    with pytest.raises(ShmooError) as refused:
        with_settings(METHODS[OURS], [text])
    assert told in str(refused.value)


def test_properties_of_objects_and_settings_are_told_apart() -> None:
    assert parted(["mass=3", "control.horizon=20", "friction=0.4"]) == (
        ["mass=3", "friction=0.4"],
        ["control.horizon=20"],
    )
    assert all("." not in field.name for field in fields(Condition)) and all(
        "." in n for n in settings_of(METHODS[OURS])
    )
