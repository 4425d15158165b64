"""Engines in processes that wait to be timed, so that all of them can take turns on the same cores in one run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from shmoo_mjx.errors import ShmooError


def usable_cores() -> int:
    """Number of cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Worker:
    """The process of one engine. `about` is what the engine reported when it was ready.

    Args:
        command: command that starts the engine.
        devices: number of CPU devices that JAX sees in it.

    Raises:
        ShmooError: the process ended before it was ready. The message contains its last line.
    """

    def __init__(self, command: Sequence[str], devices: int = 1) -> None:
        cores = str(usable_cores())
        env = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), cores)
        # A cached program would hide the compilation time.
        env |= {"JAX_NUM_CPU_DEVICES": str(devices), "JAX_ENABLE_COMPILATION_CACHE": "false"}
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 (closed in close)
        self._command = command
        try:
            self._process = subprocess.Popen(
                command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True
            )
        except OSError as error:
            self._errors.close()
            raise ShmooError(f"{command[0]}: {error.strerror}; give the path of a Python interpreter.") from None
        try:
            self.about: dict[str, Any] = self._read()
        except ShmooError:
            self.close()
            raise

    def seconds(self, calls: int) -> tuple[list[float], int]:
        """The durations of ``calls`` control steps [s], and the number of programs compiled since it was ready."""
        assert self._process.stdin
        self._process.stdin.write(f"{calls}\n")
        self._process.stdin.flush()
        answer = self._read()
        return answer["seconds"], answer["compiled"]

    def close(self) -> None:
        """End the process."""
        if self._process.stdin:
            self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        assert self._process.stdout
        self._process.stdout.close()
        self._errors.close()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout
        # Libraries may print too, so only a line that begins a JSON object is an answer.
        for line in self._process.stdout:
            if line.startswith("{"):
                answer: dict[str, Any] = json.loads(line)
                return answer
        self._process.wait()
        self._errors.seek(0)
        said = [x for x in self._errors.read().splitlines() if x.strip()] or ["it said nothing"]
        raise ShmooError(f"{' '.join(map(str, self._command[:3]))}: ended early ({said[-1].strip()}).")


def ours(spec: dict[str, Any], devices: int | None = None) -> Worker:
    """A worker with one of `engines`.

    Args:
        spec: specification of the engine (`engines`).
        devices: number of CPU devices; None for as many as there are cores, at most four.
    """
    command = [sys.executable, "-P", "-m", f"{__package__}.engines", json.dumps(spec)]
    return Worker(command, devices or min(usable_cores(), 4))


def peer(
    python: Path, engine: str, *, samples: int, horizon: int, activation: str, seed: int, device: str = "cpu"
) -> Worker:
    """A worker with one of `peers`, run by the interpreter ``python``. The ``device`` of torch is cpu or cuda."""
    script = Path(__file__).with_name("peers.py")
    sizes = (samples, horizon, activation, usable_cores(), seed, device)
    return Worker([str(python), str(script), engine, *map(str, sizes)])


@contextmanager
def busy_neighbour() -> Iterator[None]:
    """Keep one core busy with another process inside the context."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()
