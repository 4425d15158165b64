"""A pool of worker processes that ends with its parent process, and a check for forked processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.context import SpawnContext, SpawnProcess

from shmoo_mjx.errors import ShmooError

_PATIENCE = 5.0
"""Longest time to wait for the workers to end [s]."""


@contextmanager
def process_pool(workers: int, prepare: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Context manager with a pool of worker processes, which stop at an exception or when this process ends.

    The workers are spawned, because forked children would inherit JAX's locks. They share JAX's compilation cache on
    disk.

    Args:
        workers: largest number of workers.
        prepare: function that each worker calls before its first job; must be picklable.
    """
    context = _Context()
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(prepare,))
    try:
        yield pool
    except BaseException:
        # Without this, the pool would finish all running and waiting jobs first.
        pool.shutdown(wait=False, cancel_futures=True)
        # Repeat the kill, because a worker may just be starting.
        until = time.monotonic() + _PATIENCE
        while (left := multiprocessing.active_children()) and time.monotonic() < until:
            for worker in left:
                worker.kill()
            left[0].join(timeout=0.1)
        raise
    pool.shutdown()


def check_forked() -> None:
    """Raise an error in a forked process in which JAX would hang.

    A fork copies JAX's state without JAX's threads. The check works where the system lists the threads of a process
    (Linux). On other systems, new processes are not forked by default.

    Raises:
        ShmooError: this process was forked from one in which JAX was running.
    """
    # A local import, because worker processes that never compute need no JAX.
    from jax._src import xla_bridge

    with suppress(OSError):
        if len(os.listdir("/proc/self/task")) == 1 and xla_bridge.backends_are_initialized():
            raise ShmooError(
                "JAX can't run in this process, which was forked from one that already used it; start processes with "
                "multiprocessing.get_context('spawn'), or gymnasium.make_vec with vector_kwargs={'context': 'spawn'}."
            )


class _Worker(SpawnProcess):
    """A process that ignores ctrl-C, which is sent to all processes of the terminal. Only the parent handles it."""

    def start(self) -> None:
        # A new process inherits blocked signals, so not even its imports are interrupted.
        if os.name != "posix":
            super().start()
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    Process = _Worker


def _begin(prepare: Callable[[], None] | None) -> None:
    # For systems without signal masks.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()


def _end_with_parent() -> None:
    """End this worker when its parent ends, since a killed parent can't stop its workers."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
