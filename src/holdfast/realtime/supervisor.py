"""Starts the optimiser process, receives its reports, and starts a successor when it dies or hangs.

All of it in a thread that sleeps, so that it costs the IMU path nothing. The same thread ends the process: where the
kernel is to end a child with its parent, it looks at the thread that started it.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from threading import Event as Flag
from threading import Lock, Thread
from time import monotonic, sleep

from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.kernel.compiling import FOLDER
from holdfast.realtime.layout import Board
from holdfast.realtime.memory import Word
from holdfast.realtime.placement import release_cores
from holdfast.realtime.reports import Inbox, Report
from holdfast.realtime.worker import Settings

PERIOD_S = 0.05
# in which a process must have taken in what came before it; without a cache it compiles
START_S = 60.0 if FOLDER is not None else 600.0
STEADY_S = 10.0  # a process that lived for so long has not died of its start
MAX_PAUSE_S = 30.0
MANY = 1 << 20  # bytes of reports that nobody has asked for
END_S = 5.0  # in which it must have taken in what is left


class Supervisor:
    """The optimiser process and its successors.

    Args:
        settings: for the process.
        board: the shared memory.
        on_report: is given each report of the process, and after its end None.
        on_fault: is given the reason why a process ended that was not asked to.
    """

    def __init__(
        self,
        settings: Settings,
        board: Board,
        on_report: Callable[[Report | None], None],
        on_fault: Callable[[str], None],
    ) -> None:
        self._settings, self._board = settings, board
        self._on_report, self._on_fault = on_report, on_fault
        self._process: subprocess.Popen[bytes] | None = None
        self._inbox: Inbox | None = None
        self._reported_fault, self._is_successor = "", False
        self._hang_s = settings.config.realtime.hang_s
        self._began_s = self._beat_s = monotonic()
        self._beat = board.words[Word.HEARTBEAT]
        self._begun_beat = self._beat
        self._pause_s = 0.0
        self._collecting = Lock()
        self._stopping = Flag()
        self._thread = Thread(target=self._supervise, name="holdfast-supervisor", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """The process, if there is one."""
        process = self._process
        return None if process is None or process.poll() is not None else process.pid

    @property
    def learnt(self) -> LearntSnapshot:
        """What was learnt of the sensors, as of the last report."""
        return self._settings.learnt

    def wake(self) -> None:
        """Signal the process that something has come; never blocks."""
        process = self._process
        try:
            if process is not None and process.stdin is not None:
                process.stdin.write(b"\0")
        except (OSError, ValueError):
            pass  # it has ended, which the thread notices; where the pipe is full, it has been woken

    def collect(self) -> None:
        """Receive the reports that are there; in the thread of the caller, who knows when there is time for it."""
        with self._collecting:
            if self._inbox is not None:
                for report in self._inbox.receive():
                    self._reported_fault = report.fault or self._reported_fault
                    if report.learnt is not None:
                        self._settings = self._settings._replace(learnt=report.learnt)
                    self._on_report(report)

    def stop(self) -> None:
        """Let the process take in what is left, receive its last reports, and end it."""
        self._stopping.set()
        self._thread.join()

    # --- the thread ------------------------------------------------------------------------------------------------

    def _supervise(self) -> None:
        release_cores(self._settings.cores)
        self._start()
        woke_s = monotonic()
        while not self._stopping.wait(PERIOD_S):
            now_s = monotonic()
            if now_s - woke_s > 10 * PERIOD_S:
                self._beat_s = now_s  # this process did not run either
            woke_s = now_s
            self._fetch()
            fault = self._fault(now_s)
            if fault is not None:
                self._end(0.0)
                self._on_fault(self._reported_fault or fault)
                lived_s = now_s - self._began_s
                if self._is_successor and lived_s < STEADY_S:  # it may have died of what was learnt before
                    self._settings = self._settings._replace(learnt=NOTHING_LEARNT)
                self._is_successor = True
                self._pause_s = 0.0 if lived_s > STEADY_S else min(MAX_PAUSE_S, max(0.25, 2.0 * self._pause_s))
                if self._stopping.wait(self._pause_s):
                    break
                self._start()
        self._end(END_S)

    def _fetch(self) -> None:
        """Empty the pipe; to read what it held would keep the interpreter's lock from the IMU path."""
        with self._collecting:
            is_much = self._inbox is not None and self._inbox.fetch() > MANY
        if is_much:
            self.collect()  # nobody asks

    def _start(self) -> None:
        """Start the interpreter that runs this one, with the modules that this one finds."""
        readable, writable = os.pipe()
        settings = pickle.dumps(self._settings)
        memory = self._board.memory.descriptor
        command = [sys.executable, "-P", "-m", "holdfast.realtime.worker", str(memory), str(writable)]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        self._reported_fault, self._begun_beat = "", self._board.words[Word.HEARTBEAT]
        self._began_s = self._beat_s = monotonic()
        try:
            process = subprocess.Popen(
                [*command, str(len(settings))],
                stdin=subprocess.PIPE,
                stdout=2,  # what a library prints there
                bufsize=0,
                pass_fds=(memory, writable),
                env=environment,
                process_group=0,  # Ctrl-C is answered by this process
            )
        except OSError as error:
            os.close(readable)
            self._reported_fault = f"cannot be started ({error.strerror})"
            return
        finally:
            os.close(writable)
        assert process.stdin is not None
        try:
            process.stdin.write(settings)
            os.set_blocking(process.stdin.fileno(), False)
        except BrokenPipeError:
            pass  # it has died already
        self._inbox, self._process = Inbox(readable), process

    def _fault(self, now_s: float) -> str | None:
        """Say why a successor is needed."""
        if self._process is None:
            return "cannot be started"
        code = self._process.poll()
        if code is not None:
            return f"died (signal {-code})" if code < 0 else f"ended (exit code {code})"
        beat = self._board.words[Word.HEARTBEAT]
        if beat != self._beat:
            self._beat, self._beat_s = beat, now_s
        has_taken_in = beat - self._begun_beat > 1  # what had come before it, which takes the longest
        patience_s = self._hang_s if has_taken_in else START_S
        return f"hung for {patience_s:g} s" if now_s - self._beat_s > patience_s else None

    def _end(self, patience_s: float) -> None:
        """End the process; with patience it may take in what is left."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        process.stdin.close()
        until_s = monotonic() + patience_s
        while monotonic() < until_s and process.poll() is None:
            self.collect()  # so that it is not kept waiting by a full pipe
            sleep(0.002)
        if process.poll() is None:
            process.kill()
            process.wait()
        self.collect()
        with self._collecting:
            if self._inbox is not None:
                self._inbox.close()
                self._inbox = None
        self._on_report(None)
