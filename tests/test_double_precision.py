"""JAX_ENABLE_X64, which other libraries set, changes neither what an entry point can do nor the numbers it gives.

Each test runs one entry point here, without the flag, and in a process of its own with it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.arrays import single_precision

ROOT = Path(__file__).resolve().parents[1]


def mjx_engine(folder: Path) -> Any:
    """Two worlds with a box, one sample; as a library's user calls it, with double-precision arrays."""
    import shmoo_mjx as shmoo
    from shmoo_mjx.types import Command

    box = shmoo.draw_condition("box", seed=3)
    scene = shmoo.build_scene([(box, (0.0, 0.0, 0.0))], robot_pose=(-1.2, 0.0, 0.0), engine="mjx")
    engine = shmoo.MjxEngine([scene, scene])
    command = Command(jnp.tile(jnp.array([0.05, 0.0, 0.0]), (2, 1)), jnp.zeros(2), jnp.full(2, 0.4), jnp.full(2, 0.4))
    world, seen = engine.step(engine.init(), command)
    known = (engine.observe(world).time, engine.torque(world, command), engine.fallen(world), engine.robot(world).pose)
    return world.physics, seen.robot_pose, seen.object_pose, known


def vector_env(folder: Path) -> Any:
    import gymnasium

    worlds = gymnasium.make_vec("shmoo_mjx.gym:ShmooPush-v0", num_envs=2)
    first, _ = worlds.reset(seed=1)
    steps = [worlds.step(np.full(worlds.action_space.shape, 0.1, np.float32))[:2] for _ in range(2)]
    worlds.close()
    return first, steps


def conditions() -> tuple[dict[str, Any], dict[str, Any]]:
    """Objects that obey a linear law with numbers of their own."""
    rng = np.random.default_rng(0)
    inputs, laws = rng.normal(size=(6, 60, 4)), rng.normal(size=(6, 4, 2))
    data = {f"object {5 - i}": (x, x @ law) for i, (x, law) in enumerate(zip(inputs, laws, strict=True))}
    names = list(data)
    return {n: data[n] for n in names[:4]}, {n: data[n] for n in names[4:]}


def fit(folder: Path) -> Any:
    import shmoo_mjx as shmoo

    fitted = shmoo.fit(*conditions(), shmoo.DaimlConfig(epochs=2, epoch_updates=10))
    return fitted.score, fitted.prior_mean, fitted.noise


def push(folder: Path) -> Any:
    """The README's push, its first seconds: until the controller has planned some times."""
    import shmoo_mjx as shmoo

    box = shmoo.draw_condition("box", seed=3, properties={"mass": 6.0, "friction": 0.4})
    scene = shmoo.build_scene([(box, (0.0, 0.0, 0.0))], robot_pose=(-0.95, 0.0, 0.0))
    room = shmoo.OccupancyGrid(np.zeros((160, 160), np.int8), resolution=0.05, origin=(-4.0, -4.0, 0.0))
    pusher = shmoo.PushController(shmoo.load_weights(), shmoo.pose_push_config().light())
    task = shmoo.PushTask(room, [box.half_extents], goal=(0.5, 0.0, 0.0), pusher=pusher, kinds=["box"])
    planned = 0
    with shmoo.SensedEngine([scene], shmoo.REAL, poses_known=True) as robot:
        seen = robot.observe(world := robot.init())
        while planned < 3:
            world, seen = robot.step(world, task.tick(seen))
            planned += task.mode == "push"
    assert task.segment is not None and task.segment.push is not None
    state = task.segment.push.pusher
    return seen.object_pose, seen.robot_pose, state.plan.nominal, state.adapt.parameters, pusher.coast(state)


def plan(folder: Path) -> Any:
    """MPPI by itself, as in docs/how_to/cost.md, in a loop that is compiled."""
    from shmoo_mjx.control import mppi

    config = mppi.MppiConfig((0.3, 0.2), (-1.0, -1.0), (1.0, 1.0), num_rollouts=32, horizon=5)

    def one(state: mppi.MppiState, _: None) -> tuple[mppi.MppiState, jax.Array]:
        u, after, _ = mppi.plan(
            config, lambda x0, u: x0 + jnp.cumsum(u, axis=1), lambda x, u, last: jnp.sum((x - 1) ** 2, axis=(1, 2)),
            jnp.zeros(2, jnp.float32), state=state,
        )  # fmt: skip
        return after, u

    return jax.lax.scan(one, mppi.init(config, jax.random.key(0)), None, length=3)[1].astype(jnp.float32)


def robot_training(folder: Path) -> Any:
    """`shmoo train robot`, and the object's part on the same recording."""
    from shmoo_mjx.data.collect import CollectConfig, collect
    from shmoo_mjx.dynamics.object_model import ObjectConfig
    from shmoo_mjx.learning import daiml, robot_fit
    from shmoo_mjx.learning.weights import load_weights, save_weights, untrained, with_object, with_robot

    data = folder / "data"
    collect(data, CollectConfig(train=1, validation=1, episodes=1, seconds=3.0), workers=1)
    brief = {"epochs": 1, "epoch_updates": 3}
    robot = robot_fit.train_robot(data, None, robot_fit.RobotFitConfig(**brief, horizon=2))
    shape = ObjectConfig(contact_model=False)
    thing = daiml.train_object(data, None, daiml.DaimlConfig(**brief, object=shape, horizon=4, windows=4))
    made = with_object(with_robot(untrained(), robot), thing)
    save_weights(folder / "made.safetensors", made)
    leaves = jax.tree.leaves(load_weights(folder / "made.safetensors").params)
    assert {leaf.dtype for leaf in leaves} == {np.dtype(np.float32)}
    return robot.score, thing.score, [jnp.sum(leaf) for leaf in leaves]


def demo(folder: Path) -> Any:
    from shmoo_mjx.report.trace import load_trace
    from shmoo_mjx.run.demo import run_demo

    assert run_demo(range(1), folder, None, video=False, senses="real") == 0
    trace = load_trace(folder / "demo-0" / "trace.npz")
    # Until the first contact, from which on the last bits grow.
    return trace.robot_pose[:80:10], trace.object_pose[:80:10]


def sweep(folder: Path) -> Any:
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.sweep import worlds
    from shmoo_mjx.sweep.config import SweepConfig
    from shmoo_mjx.sweep.simulate import Batches

    config = SweepConfig.model_validate(
        {
            "worlds": 2,
            "seconds": 1,  # until the first contact, from which on the last bits grow
            "vary": {"object.mass": 5.0, "noise.position": 0.003},
            "controllers": {"ours": {"kind": "mppi", "samples": 16, "horizon": 4}},
        }
    )
    rows = Batches(config, "box", "ours", load_weights()).run([worlds.draw(config, "box", i) for i in range(2)])
    return [[value for value in row.values() if isinstance(value, float)] for row in rows]


ENTRIES: dict[str, Callable[[Path], Any]] = {
    f.__name__: f for f in (mjx_engine, vector_env, fit, push, plan, robot_training, demo, sweep)
}
SLOW = ("mjx_engine", "vector_env", "fit", "push", "robot_training", "demo", "sweep")


def numbers(tree: Any) -> list[float]:
    return [float(x) for leaf in jax.tree.leaves(tree) for x in np.ravel(np.asarray(leaf))]


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in ENTRIES])
def test_the_flag_changes_nothing(name: str, tmp_path: Path) -> None:
    code = f"from test_double_precision import main; main({name!r})"
    env = os.environ | {"JAX_ENABLE_X64": "1", "PYTHONPATH": str(ROOT / "tests")}
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "wide")], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    wide = json.loads(done.stdout.splitlines()[-1])
    plain = numbers(ENTRIES[name](tmp_path / "plain"))
    assert len(plain) > 1 and np.isfinite(plain).any()
    np.testing.assert_allclose(wide, plain, rtol=1e-5, atol=1e-6)


def main(name: str) -> None:
    """Run in the other process."""
    assert jnp.zeros(1).dtype == np.float64
    print(json.dumps(numbers(ENTRIES[name](Path(sys.argv[1])))))


def test_a_flag_that_is_set_later_is_no_different() -> None:
    """Another library may set it after ours has compiled, for its own thread, or with stricter rules of promotion."""

    @single_precision
    def add(x: Any, given: dict[str, Any]) -> Any:
        return jax.jit(lambda x: jax.lax.scan(lambda c, _: (c + jnp.ones(2) * np.ones(2), None), x, None, 3)[0])(
            x
        ), list(given)

    narrow, _ = add(jnp.zeros(2), {})
    with jax.enable_x64(True), jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        wide, order = add(jnp.zeros(2), {"b": jnp.zeros(1), "a": 1})
        traced, _ = jax.jit(lambda x: add(x, {}))(jnp.zeros(2))
        assert jnp.zeros(1).dtype == np.float64
    assert narrow.dtype == wide.dtype == traced.dtype == np.float32 and order == ["b", "a"]
    assert wide.tolist() == traced.tolist() == narrow.tolist()
