"""A registration library in a process of its own, because it holds the interpreter's lock for whole sweeps.

The process is spawned and connected by one pipe. It ends when the pipe closes, however the parent ends.
"""

import signal
from collections import deque
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Self

from holdfast.errors import EstimatorError
from holdfast.lidar_odometry.masked import Masked, Masking
from holdfast.lidar_odometry.registration import Registered, make_registration
from holdfast.lidar_odometry.sweep import Sweep

MAX_PENDING_SWEEPS = 2  # one is registered while the next one is decoded
PATIENCE_S = 5.0


class RegistrationProcess:
    """Sweeps in, poses out in the same order; a context manager that ends the process."""

    def __init__(self, method: str, threads: int, masking: Masking | None = None) -> None:
        self._method = method
        self._results: deque[Registered] = deque()
        self._in_flight = 0
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs, method, threads, masking), daemon=True)
        # a Ctrl-C, or the end of a service, goes to the whole group; the child inherits this block, the parent decides;
        # starting multiprocessing's own tracker of resources would lift the block, so that one comes first
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    @property
    def pid(self) -> int | None:
        """Return the number of the process."""
        return self._process.pid

    def submit(self, sweep: Sweep) -> None:
        """Hand over a sweep; waits while too many are pending.

        Raises:
            EstimatorError: the process failed, with its error in one line.
        """
        while self._in_flight >= MAX_PENDING_SWEEPS:
            self._results.append(self._receive())
        try:
            self._connection.send(sweep)
        except OSError:
            while True:  # until it sends its error, or its exit code is known
                self._results.append(self._receive())
        self._in_flight += 1

    def result(self) -> Registered:
        """Return the pose of the earliest sweep that has not been returned yet; errors as in `submit`."""
        return self._results.popleft() if self._results else self._receive()

    def _receive(self) -> Registered:
        try:
            answer = self._connection.recv()
        except (EOFError, OSError):
            raise self._ended() from None
        if isinstance(answer, Registered):
            self._in_flight -= 1
            return answer
        raise EstimatorError(answer)

    def _ended(self) -> EstimatorError:
        self._process.join(PATIENCE_S)
        code = self._process.exitcode
        how = f"was killed by {signal.Signals(-code).name}" if code is not None and code < 0 else f"ended with {code}"
        return EstimatorError(f"lidar odometry by {self._method}: its process {how}")

    def __enter__(self) -> Self:
        """Return the process itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process: at once after an error, else when it is idle."""
        self._connection.close()
        if error is None:
            self._process.join(PATIENCE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def serve(connection: Connection, method: str, threads: int, masking: Masking | None = None) -> None:
    """Answer each sweep with its pose until the other end closes; a failure is answered with its error in one line."""
    try:
        registration = make_registration(method, threads)
        if masking is not None:
            registration = Masked(registration, masking)
        while True:
            connection.send(registration.register(connection.recv()))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except Exception as error:  # whatever a library throws, the parent reports it in one line
        text = " ".join(str(error).split())
        connection.send(f"lidar odometry by {method} failed: {type(error).__name__}: {text}")
