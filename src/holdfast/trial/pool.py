"""Long work side by side in processes, which end with the one that started them."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import TypeVar

from holdfast.errors import HoldfastError

POLL_S = 0.5
T = TypeVar("T")


@contextmanager
def processes(jobs: int, if_killed: str) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of so many new processes; an exception inside `with` ends them at once.

    Raises:
        HoldfastError: one of them was killed; its text is `if_killed`.
    """
    # one process per core is enough: no threads below it; the processes inherit this
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    others = active_children()
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), _end_with_parent)
    is_done = False
    try:
        yield pool
        is_done = True
    except BrokenProcessPool:
        raise HoldfastError(if_killed) from None
    finally:
        pool.shutdown(wait=is_done, cancel_futures=True)
        for process in [] if is_done else set(active_children()).difference(others):
            process.kill()
            while process.is_alive():  # `join` alone returns early if the thread of the pool has just reaped it
                process.join(POLL_S)


def run_all(pool: ProcessPoolExecutor, calls: Sequence[Callable[[], T]], take: Callable[[list[T]], None]) -> None:
    """Run calls in a pool of `processes`; the first that raises stops the others.

    Args:
        pool: where they run.
        calls: what is run; they can be sent to another process.
        take: called every now and then with what has come since, in any order.
    """
    with _ignoring_interrupts():
        waiting: set[Future[T]] = {pool.submit(call) for call in calls}
    while waiting:
        done, waiting = wait(waiting, timeout=POLL_S, return_when=FIRST_EXCEPTION)
        take([future.result() for future in done])


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Start processes that ignore Ctrl-C and its like: this one handles them, and ends the processes."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}  # inherited
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _end_with_parent() -> None:
    """Let a process of the pool end with the one that started it, even if that is killed."""
    Thread(target=_watch, name="parent", daemon=True).start()


def _watch() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
