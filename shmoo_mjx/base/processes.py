"""A pool of worker processes that does not outlive the process it works for, and a check of processes of others."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress

from shmoo_mjx.errors import ShmooError

_PATIENCE = 5.0
"""Longest time that ending the workers may take [s]."""


@contextmanager
def process_pool(workers: int, prepare: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Worker processes; an exception, or the end of this process however it comes, stops them too.

    Forked children would inherit JAX's locks; these are spawned, start clean, and share its compilation cache on disk.

    Args:
        workers: how many, at most.
        prepare: called in each before its first job; must be picklable.
    """
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(prepare,))
    try:
        yield pool
    except BaseException:
        # Otherwise every job that still waits would be run first, and those under way to their end.
        pool.shutdown(wait=False, cancel_futures=True)
        # One may just be starting.
        until = time.monotonic() + _PATIENCE
        while (left := multiprocessing.active_children()) and time.monotonic() < until:
            for worker in left:
                worker.kill()
            left[0].join(timeout=0.1)
        raise
    pool.shutdown()


def check_forked() -> None:
    """Refuse to compute in a process in which JAX would wait for ever.

    A fork copies JAX's state without the threads that JAX works with. Checked where the system lists a process's
    threads (Linux); elsewhere new processes are not forked by default.

    Raises:
        ShmooError: this process was forked from one in which JAX was running.
    """
    # Imported late: worker processes that never compute need no JAX.
    from jax._src import xla_bridge

    with suppress(OSError):
        if len(os.listdir("/proc/self/task")) == 1 and xla_bridge.backends_are_initialized():
            raise ShmooError(
                "JAX can't run in this process, which was forked from one that already used it; start processes with "
                "multiprocessing.get_context('spawn'), or gymnasium.make_vec with vector_kwargs={'context': 'spawn'}."
            )


def _begin(prepare: Callable[[], None] | None) -> None:
    # Ctrl-C reaches every process of the terminal; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()


def _end_with_parent() -> None:
    """A parent that is killed has no time to tell its workers."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
