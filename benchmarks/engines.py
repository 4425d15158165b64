"""Engines of the MPPI benchmark that use JAX, each in a process of its own: python -m benchmarks.engines SPEC.

SPEC is JSON: engine, samples, horizon, problems, activation, seed. The engines:

* ``ours``: the whole control step of `control.pushing` from observation to u, with the shipped weights: adaptation,
  sampling, features, networks, contact rules, the cost of a push with its map, update.
* ``ours_paper``: the same with the paper's widths of psi and no linear terms, untrained, and Eq. 9 as the only cost.
* ``plain_jax``: the common problem of `mppi_problem` in plain JAX: vmap, scan, jit.
* ``gemm``: one matrix product in single precision, which gives the rate of a machine with a GPU.
* ``batch``: several problems planned in one call, each with ``mppi.plan`` over the learned core. The devices share the
  roll-outs of a single problem, and otherwise they share the problems.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.control import cost, mppi, pushing, sharding
from shmoo_mjx.control.observation import ObjectObservation, local_distance_field
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.dynamics import CoreConfig, ObjectConfig, RobotConfig, core
from shmoo_mjx.learning import weights as weights_file
from shmoo_mjx.types import SystemState

from . import mppi_problem as work
from .peers import serve

HALF_EXTENTS = np.array([0.3, 0.25])
FACE = np.array([-0.3, 0.0, 0.0, 0.25])
GOAL = np.array([2.0, 0.4, 0.0])


class _Corridor:
    """Distance field of a corridor 2.4 m wide."""

    def at(self, points: Array) -> Array:
        return np.maximum(1.2 - np.abs(points[..., 1]), 0.0)


def _sighting(rng: np.random.Generator) -> ObjectObservation:
    """Observation with the hands on the face, and a little noise so that no two steps see the same."""
    noise = 0.01 * rng.standard_normal((7, 3))
    return ObjectObservation(
        robot_pose=noise[0],
        robot_twist=np.array([0.2, 0.0, 0.0]) + noise[1],
        lean=noise[2, :2],
        lean_rate=noise[3, :2],
        object_pose=np.array([0.75, 0.02, 0.05]) + noise[4],
        object_twist=np.array([0.2, 0.0, 0.0]) + noise[5],
        wrench=np.array([8.0, 0.0, 0.3]) + noise[6],
    )


def paper_form(activation: str, seed: int) -> tuple[weights_file.Weights, PushConfig]:
    """Untrained weights with the paper's widths, and Eq. 9 as the only cost."""
    body = replace(ObjectConfig.paper(), activation=activation)
    robot = replace(RobotConfig.paper(), activation=activation)
    weights = weights_file.untrained(CoreConfig(robot=robot, object=body), seed)
    return weights, PushConfig(cost=cost.PushCost())


def ours(weights: weights_file.Weights, config: PushConfig, seed: int) -> Callable[[], Any]:
    """The control step of a push. Each call continues from the state of the last one."""
    controller = pushing.PushController(weights, config)
    rng = np.random.default_rng(seed)
    state = controller.init(_sighting(rng), FACE, HALF_EXTENTS, jax.random.key(seed))
    around = local_distance_field(_Corridor(), np.zeros(2))
    u = np.zeros(3)

    def step() -> Any:
        nonlocal state, u
        u, state, plan = controller.step(
            state, _sighting(rng), goal=GOAL, last_u=u, half_extents=HALF_EXTENTS, clearance=around
        )
        return jax.block_until_ready((state, plan))

    return step


def plain_jax(samples: int, horizon: int, activation: str, seed: int) -> Callable[[], Any]:
    """The step of the common problem in plain JAX: single roll-outs, vmap, jit."""
    problem = jax.tree.map(jnp.asarray, work.draw(seed))
    act = jnp.tanh if activation == "tanh" else jax.nn.relu

    def net(layers: list, x: Array) -> Array:
        for i, (weight, bias) in enumerate(layers):
            x = x @ weight + bias
            x = act(x) if i + 1 < len(layers) else x
        return x

    def rollout(controls: Array) -> Array:
        def body(x: Any, u: Any) -> tuple[Any, Any]:
            new = work.transition(
                jnp, partial(net, problem.robot), lambda s: net(problem.psi, s) @ problem.coefficients.T, x=x, u=u[None]
            )
            return new, new[0]

        return jax.lax.scan(body, problem.x0[None], controls)[1]

    @jax.jit
    def plan(nominal: Array, key: Array) -> tuple[Array, Array, Array, Array]:
        key, use = jax.random.split(key)
        noise = work.SIGMA * jax.random.normal(use, (samples, horizon, 3))
        controls = jnp.clip(nominal + noise, -work.BOUND, work.BOUND)
        states = jax.vmap(rollout)(controls)
        costs = work.cost(jnp, problem.goal, states[:, -1], controls)
        best = jnp.einsum("s,stm->tm", jax.nn.softmax(-costs / work.TEMPERATURE), controls)
        return best[0], jnp.concatenate([best[1:], best[-1:]]), key, states

    nominal, key = jnp.zeros((horizon, 3)), jax.random.key(seed)

    def step() -> Any:
        nonlocal nominal, key
        u, nominal, key, states = jax.block_until_ready(plan(nominal, key))
        return np.asarray(u), states

    return step


def gemm(size: int) -> Callable[[], Any]:
    """A step that computes one float32 matrix product with ``size`` rows and columns."""
    a, b = jax.random.uniform(jax.random.key(0), (2, size, size))
    product = jax.jit(jnp.matmul)
    return lambda: jax.block_until_ready(product(a, b))


def batch(samples: int, horizon: int, problems: int, seed: int) -> Callable[[], Any]:
    """A step that plans for ``problems`` states in one call, with Eq. 9 as the cost."""
    weights = weights_file.load_weights(asset(WEIGHTS))
    cfg = replace(PushConfig().control, num_rollouts=samples, horizon=horizon)
    mesh = sharding.rollout_mesh(samples) if problems == 1 else None

    def one(params: core.Params, x0: SystemState, state: mppi.MppiState) -> Any:
        def rollout_fn(x: SystemState, controls: Array) -> SystemState:
            return core.rollout(params, x, controls, weights.config)[0]

        cost_fn = cost.push_cost(cost.PushCost(), GOAL)
        share = mesh and partial(sharding.shared, mesh)
        u, after, plan = mppi.plan(cfg, rollout_fn, cost_fn, x0, state=state, share=share)
        u, after = sharding.on_all(mesh, (u, after))
        return u, after, plan.costs

    if problems == 1:
        run = sharding.compiled(jax.vmap(one, in_axes=(None, 0, 0)), mesh)
    else:
        run = jax.jit(sharding.each_problem(one, problems))
    params = sharding.replicated(mesh, weights.params)
    rng = np.random.default_rng(seed)
    starts = jax.tree.map(lambda *x: np.stack(x).astype(np.float32), *(_state(rng) for _ in range(problems)))
    states = jax.vmap(partial(mppi.init, cfg))(jax.random.split(jax.random.key(seed), problems))

    def step() -> Any:
        nonlocal states
        u, states, costs = jax.block_until_ready(run(params, starts, states))
        return np.asarray(u), costs

    return step


def _state(rng: np.random.Generator) -> SystemState:
    seen, zero = _sighting(rng), np.zeros(3)
    memory: dict[str, Any] = {
        "last_object_twist": zero,
        "last_wrench": zero,
        "last_force": zero[:2],
        "last_u": zero,
        "face": FACE,
        "size": 0.39,
    }
    perceived: dict[str, Any] = {k: v for k, v in seen._asdict().items() if k in SystemState._fields}
    return SystemState(**perceived, **memory)


def main() -> None:
    """Build the engine that the argument names and serve it."""
    spec = json.loads(sys.argv[1])
    compilations = [0]

    def count(event: str, duration_secs: float, **_: str | int) -> None:
        compilations[0] += event == "/jax/core/compile/backend_compile_duration"

    jax.monitoring.register_event_duration_secs_listener(count)
    engine, size = spec["engine"], (spec["samples"], spec["horizon"])
    if engine == "batch":
        step = batch(*size, spec["problems"], spec["seed"])
    elif engine == "plain_jax":
        step = plain_jax(*size, spec["activation"], spec["seed"])
    elif engine == "gemm":
        step = gemm(spec["samples"])
    else:
        shipped = weights_file.load_weights(asset(WEIGHTS)), PushConfig()
        weights, config = paper_form(spec["activation"], spec["seed"]) if engine == "ours_paper" else shipped
        control = replace(config.control, num_rollouts=spec["samples"], horizon=spec["horizon"])
        step = ours(weights, replace(config, control=control), spec["seed"])
    started = time.perf_counter()
    step()
    about = {"first_s": time.perf_counter() - started, "jax": jax.__version__}
    for _ in range(3):
        step()
    devices = jax.devices()
    before = compilations[0]
    about |= {"device": f"{len(devices)} x {devices[0].device_kind}"}
    serve(step, about, lambda: compilations[0] - before)


if __name__ == "__main__":
    main()
