"""World i is the same world whatever else is swept and however worlds are cut up."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.engine_mjx import MjxEngine
from shmoo_mjx.plant.objects import FAMILIES
from shmoo_mjx.sweep import worlds
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.parameters import PARAMETERS

VARY: dict[str, Any] = {
    "object.mass": {"log_uniform": (2, 40)},
    "object.friction": {"uniform": (0.1, 0.8)},
    "robot.com_x": {"normal": (0.0, 0.01)},
    "noise.position": {"uniform": (0, 0.01)},
    "delay.command": {"choice": (0, 0.02, 0.05)},
    "goal.bearing": {"uniform": (-0.2, 0.2)},
}


def config(**changes: Any) -> SweepConfig:
    return SweepConfig.model_validate({"vary": VARY, **changes})


def arrays(setup: worlds.WorldSetup) -> list[np.ndarray]:
    plain = setup._replace(key=jax.random.key_data(setup.key))
    return [np.asarray(x) for x in jax.tree.leaves(plain)]


def test_a_world_depends_on_nothing_but_its_number_seed_and_family() -> None:
    plain = [worlds.draw(config(), "box", i) for i in range(4)]
    cut = config(worlds=7, shard=3, controllers={"other": {"kind": "quasi_static"}}, families=["cart", "box"])
    assert [worlds.draw(cut, "box", i) for i in range(4)][3].values == plain[3].values
    assert worlds.draw(config(seed=1), "box", 2).values != plain[2].values
    assert worlds.draw(config(), "cart", 2).values["object.mass"] != plain[2].values["object.mass"]
    assert len({w.values["object.mass"] for w in plain}) == 4
    assert len({w.condition.size for w in plain}) == 4


def test_varying_one_more_leaves_the_others_as_they_were() -> None:
    fewer = {k: v for k, v in VARY.items() if k != "object.mass"}
    many, few = (worlds.draw(config(vary=v), "box", 5).values for v in (VARY, fewer))
    assert {k for k in many if many[k] != few[k]} == {"object.mass"}


def test_all_parameters_have_a_value_and_the_objects_are_true() -> None:
    cart = worlds.draw(config(vary={"object.rolling": 0.03, "object.payload": 4.0}), "cart", 0)
    assert set(cart.values) == set(PARAMETERS)
    assert cart.condition.rolling == (0.03,) * 4 and cart.values["object.payload"] == cart.condition.payload == 4.0
    assert set(PARAMETERS) - set(worlds.draw(config(), "box", 0).values) == {
        "object.rolling", "object.swivel_friction"
    }  # fmt: skip
    with pytest.raises(ShmooError, match="no wheels"):
        worlds.draw(config(vary={"object.rolling": 0.03}), "box", 0)


@pytest.fixture(scope="module")
def nominals() -> dict[str, tuple[Any, Any]]:
    found = {}
    for family in FAMILIES:
        scene = worlds.scene_of(worlds.draw(config(), family, 0))
        found[family] = (jax.device_get(MjxEngine([scene], devices=jax.devices()[:1]).model), scene)
    return found


def test_arrays_do_not_depend_on_the_cut(nominals: dict[str, tuple[Any, Any]]) -> None:
    drawn = [worlds.draw(config(), "box", i) for i in range(5)]
    whole = arrays(worlds.set_up(config(), drawn, *nominals["box"]))
    parts = [arrays(worlds.set_up(config(), drawn[a:b], *nominals["box"])) for a, b in ((0, 1), (1, 5))]
    for all_, first, rest in zip(whole, *parts, strict=True):
        np.testing.assert_array_equal(all_, np.concatenate([first, rest]))
    assert len({a.tobytes() for a in whole[-1]}) == 5  # every world's key


@pytest.mark.parametrize("family", FAMILIES)
def test_nothing_that_physics_depends_on_is_left_out(family: str, nominals: dict[str, tuple[Any, Any]]) -> None:
    """World by world MJX's own model of it, beside the nominal one with the setup's fields."""
    drawn = [worlds.draw(config(), family, i) for i in range(4)]
    nominal, scene = nominals[family]
    setup = worlds.set_up(config(), drawn, nominal, scene)
    only_seen = (".light_", ".geom_rgba", ".stat.extent", ".stat.center", ".stat.meansize", ".stat.meanmass")
    for i, one in enumerate(drawn):
        true = MjxEngine([worlds.scene_of(one)]).model
        mine = nominal.tree_replace({k: v[i] for k, v in setup.fields.items()})
        assert len(jax.tree.leaves(true)) == len(jax.tree.leaves(mine))
        for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(true), jax.tree.leaves(mine), strict=True):
            if not jax.tree_util.keystr(path).startswith(only_seen):
                np.testing.assert_array_equal(np.asarray(a), np.asarray(b), err_msg=jax.tree_util.keystr(path))
        np.testing.assert_array_equal(true._impl.dof_hasfrictionloss, nominal._impl.dof_hasfrictionloss)


def test_brakes_differ_between_worlds_of_one_program() -> None:
    locked = {sum(worlds.draw(config(), "cart", i).condition.locked) for i in range(12)}
    assert locked == {0, 1, 2}
