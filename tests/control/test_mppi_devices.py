"""The samples shared out among devices give the plan that one device gives.

Devices are counted when JAX starts, so each count is a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = """
import sys, jax, jax.numpy as jnp, numpy as np
from functools import partial
from shmoo_mjx.control import mppi, sharding

cfg = mppi.MppiConfig((0.06, 0.06, 0.15), (-0.2, -0.2, -0.5), (0.2, 0.2, 0.5), num_rollouts=60, horizon=5)
mesh = sharding.rollout_mesh(cfg.num_rollouts)
compilations = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **_: compilations.append(1) if "backend_compile" in event else None)

def step(gain, x0, state):
    def rollout_fn(x0, controls):  # a scan with a constant start, as users write it
        start = jnp.broadcast_to(x0, (controls.shape[0], 3))
        body = lambda x, u: (x + u @ gain,) * 2
        return jnp.moveaxis(jax.lax.scan(body, start, jnp.moveaxis(controls, 1, 0))[1], 0, 1)
    def cost_fn(seen, controls, last):
        return 30 * jnp.sum((seen[:, -1] - 1) ** 2, -1) + jnp.sum((controls[:, 0] - last) ** 2, -1)
    u, after, plan = mppi.plan(
        cfg, rollout_fn, cost_fn, x0, state=state, share=mesh and partial(sharding.shared, mesh))
    return *sharding.on_all(mesh, (u, after)), plan

run = sharding.compiled(step, mesh)
gain = sharding.replicated(mesh, jnp.eye(3) + 0.1)
state, x0, trail = mppi.init(cfg, jax.random.key(5)), np.zeros(3, np.float32), []
for i in range(4):
    u, state, plan = run(gain, x0, state)
    x0 = x0 + np.asarray(u)
    trail.append(np.concatenate([np.asarray(plan.nominal).ravel(), np.asarray(plan.costs)]))
    if i == 1:
        first = len(compilations)
again = len(compilations) - first
many = sharding.compiled(jax.vmap(step, in_axes=(None, 0, 0)), mesh)
states = jax.vmap(lambda k: mppi.init(cfg, k))(jax.random.split(jax.random.key(6), 3))
batch = many(gain, np.ones((3, 3), np.float32), states)[0]
used, mesh, gain = 1 if mesh is None else mesh.size, None, jnp.eye(3) + 0.1
three = [np.ones((3, 3), np.float32), states]
four = jax.tree.map(lambda x: jnp.concatenate([x, x[:1]]), three)
turns = [jax.jit(sharding.each_problem(step, n))(gain, *given) for n, given in ((3, three), (4, four))]
np.savez(sys.argv[1], trail=np.stack(trail), batch=batch, devices=used,
         parts=len(plan.trajectories.sharding.device_set), again=again,
         turns=turns[0][0], turns4=turns[1][0], parts4=len(turns[1][0].sharding.device_set))
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[int, dict[str, np.ndarray]]:
    """What the script finds with one, two and seven devices asked for."""
    folder = tmp_path_factory.mktemp("devices")
    found = {}
    for count in (1, 2, 7):
        path: Path = folder / f"{count}.npz"
        env = os.environ | {"JAX_NUM_CPU_DEVICES": str(count), "XLA_FLAGS": "", "JAX_PLATFORMS": "cpu"}
        subprocess.run([sys.executable, "-c", SCRIPT, str(path)], env=env, check=True)
        with np.load(path) as data:
            found[count] = dict(data)
    return found


@pytest.mark.slow
def test_one_and_two_devices_give_the_same_plans(results: dict[int, dict[str, np.ndarray]]) -> None:
    assert [int(results[n]["devices"]) for n in (1, 2)] == [1, 2]
    assert [int(results[n]["parts"]) for n in (1, 2)] == [1, 2]
    np.testing.assert_allclose(results[2]["trail"], results[1]["trail"], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(results[2]["batch"], results[1]["batch"], rtol=1e-5, atol=1e-5)
    assert [int(results[n]["again"]) for n in (1, 2)] == [0, 0]
    # Problems one after another, on one device or each on its own.
    assert [int(results[n]["parts4"]) for n in (1, 2, 7)] == [1, 2, 4]
    for n in (1, 2, 7):
        np.testing.assert_allclose(results[n]["turns"], results[1]["batch"], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(results[n]["turns4"][:3], results[1]["batch"], rtol=1e-5, atol=1e-5)
    assert np.abs(np.diff(results[1]["trail"], axis=0)).max() > 1e-3


@pytest.mark.slow
def test_samples_that_do_not_divide_take_fewer_devices(results: dict[int, dict[str, np.ndarray]]) -> None:
    assert int(results[7]["devices"]) == 6
    np.testing.assert_allclose(results[7]["trail"], results[1]["trail"], rtol=1e-5, atol=1e-5)


CONTROLLER = """
from dataclasses import replace
import jax, numpy as np
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.control import pushing
from shmoo_mjx.control.observation import local_distance_field
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.learning.weights import load_weights

config = PushConfig()
config = replace(config, control=replace(config.control, num_rollouts=20, horizon=3))
controller = pushing.PushController(load_weights(asset(WEIGHTS)), config)
around = local_distance_field(type("Free", (), {"at": lambda self, p: p[..., 0] * 0 + 9.0})(), np.zeros(2))
half, u = np.full(2, 0.3), np.zeros(3)
seen = pushing._STILL
state = controller.init(seen, np.array([-0.3, 0.0, 0.0, 0.3]), half, jax.random.key(0))
for _ in range(3):
    goal = np.array([2.0, 0.0, 0.0])
    u, state, _ = controller.step(state, seen, goal=goal, last_u=u, half_extents=half, clearance=around)
print(len(jax.devices()), controller._learn_and_plan._cache_size())
"""


@pytest.mark.slow
def test_the_controller_is_compiled_once_on_two_devices() -> None:
    env = os.environ | {"JAX_NUM_CPU_DEVICES": "2", "XLA_FLAGS": "", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run([sys.executable, "-c", CONTROLLER], env=env, check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["2", "1"]
