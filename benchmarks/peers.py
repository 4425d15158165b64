"""Peers of the MPPI benchmark, each in a process with its own interpreter: NumPy, pytorch_mppi eager and compiled.

`mppi` runs: python peers.py ENGINE SAMPLES HORIZON ACTIVATION THREADS SEED DEVICE. The program prints one line of JSON
when it is ready. It then answers each number n on its input with the durations of n control steps. It needs NumPy and
the file `mppi_problem` beside it; pytorch_mppi also needs ``pip install torch pytorch-mppi``.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
import mppi_problem as work

Array = Any


def numpy_engine(samples: int, horizon: int, activation: str, seed: int) -> Callable[[], Any]:
    """The step of the common problem in plain NumPy."""
    problem = work.draw(seed)
    rng = np.random.default_rng(seed + 1)

    def act(h: Array) -> Array:
        return np.tanh(h, out=h) if activation == "tanh" else np.maximum(h, 0, out=h)

    def net(layers: list, x: Array) -> Array:
        for i, (weight, bias) in enumerate(layers):
            x = x @ weight
            x += bias
            x = act(x) if i + 1 < len(layers) else x
        return x

    def push(inputs: Array) -> Array:
        return net(problem.psi, inputs) @ problem.coefficients.T

    nominal = np.zeros((horizon, 3), np.float32)

    def step() -> Array:
        nonlocal nominal
        noise = np.float32(work.SIGMA) * rng.standard_normal((samples, horizon, 3), dtype=np.float32)
        controls = np.clip(nominal + noise, -work.BOUND, work.BOUND)
        x = np.broadcast_to(problem.x0, (samples, 31))
        states = np.empty((horizon, samples, 31), np.float32)
        for t in range(horizon):
            x = states[t] = work.transition(np, lambda s: net(problem.robot, s), push, x=x, u=controls[:, t])
        costs = work.cost(np, problem.goal, x, controls)
        weights = np.exp((costs.min() - costs) / work.TEMPERATURE)
        best = np.einsum("s,stm->tm", weights / weights.sum(), controls)
        nominal = np.concatenate([best[1:], best[-1:]])
        return best[0], states

    return step


def torch_engine(
    samples: int, horizon: int, activation: str, seed: int, *, threads: int, device: str, compiled: bool
) -> Callable[[], Any]:
    """The step of pytorch_mppi's own controller on the same networks and cost. ``device`` is cpu or cuda."""
    import torch
    from pytorch_mppi import MPPI

    torch.set_num_threads(threads)
    torch.manual_seed(seed)
    problem = work.draw(seed)
    goal = torch.from_numpy(problem.goal).to(device)
    a = torch.from_numpy(problem.coefficients).T.contiguous().to(device)

    def net(layers: list) -> Any:
        modules: list[Any] = []
        for weight, bias in layers:
            layer = torch.nn.Linear(*weight.shape)
            layer.weight.data, layer.bias.data = torch.from_numpy(weight.T.copy()), torch.from_numpy(bias.copy())
            modules += [layer, torch.nn.Tanh() if activation == "tanh" else torch.nn.ReLU()]
        return torch.nn.Sequential(*modules[:-1]).requires_grad_(False).eval().to(device)

    robot, psi = net(problem.robot), net(problem.psi)

    def dynamics(x: Array, u: Array) -> Array:
        return work.transition(torch, robot, lambda s: psi(s) @ a, x=x, u=u)

    def running_cost(x: Array, u: Array) -> Array:
        return work.EFFORT * torch.linalg.vector_norm(u, dim=-1)

    def terminal_cost(states: Array, actions: Array) -> Array:  # [M, K, T, n], M = 1
        moved = torch.linalg.vector_norm(actions[..., 1:, :] - actions[..., :-1, :], dim=-1).sum(-1)
        return torch.linalg.vector_norm(states[..., -1, 25:28] - goal, dim=-1) + work.CHANGE * moved

    bound = torch.full((3,), work.BOUND, device=device)
    controller = MPPI(
        dynamics,
        running_cost,
        31,
        work.SIGMA**2 * torch.eye(3, device=device),
        num_samples=samples,
        horizon=horizon,
        lambda_=work.TEMPERATURE,
        u_min=-bound,
        u_max=bound,
        U_init=torch.zeros(horizon, 3, device=device),
        device=device,
        terminal_state_cost=terminal_cost,
    )
    if compiled:
        controller.compile()
    x0 = torch.from_numpy(problem.x0).to(device)
    # torch.compile does not support inference mode.
    mode = torch.no_grad if compiled else torch.inference_mode

    def step() -> Array:
        with mode():
            return controller.command(x0).cpu().numpy()

    return step


def gemm(size: int) -> Callable[[], Any]:
    """A step that computes one float32 matrix product, which gives the rate of the machine."""
    rng = np.random.default_rng(0)
    a, b = rng.random((size, size), dtype=np.float32), rng.random((size, size), dtype=np.float32)
    out = np.empty((size, size), np.float32)
    return lambda: np.matmul(a, b, out=out)


def serve(step: Callable[[], Any], about: dict[str, Any], compiled: Callable[[], int] = lambda: 0) -> None:
    """Print ``about`` as JSON, then time n steps for every n on the input.

    Args:
        step: one control step.
        about: facts about the engine.
        compiled: number of programs that have been compiled since the engine was ready.
    """
    print(json.dumps(about), flush=True)
    for line in sys.stdin:
        seconds = []
        for _ in range(int(line)):
            started = time.perf_counter()
            step()
            seconds.append(time.perf_counter() - started)
        print(json.dumps({"seconds": seconds, "compiled": compiled()}), flush=True)


def main() -> None:
    """Build the engine that the arguments name and serve it."""
    engine, samples, horizon, activation, threads, seed, device = sys.argv[1:8]
    size = (int(samples), int(horizon), activation, int(seed))
    about: dict[str, Any] = {"numpy": np.__version__}
    if engine == "gemm":
        step = gemm(int(samples))
    elif engine == "numpy":
        step = numpy_engine(*size)
    else:
        import torch

        about |= {"torch": torch.__version__, "device": device}
        step = torch_engine(*size, threads=int(threads), device=device, compiled=engine == "pytorch_mppi_compiled")
    started = time.perf_counter()
    for _ in range(3):
        step()
    serve(step, about | {"first_s": time.perf_counter() - started})


if __name__ == "__main__":
    main()
