"""The schedulers of jobs: processes on this machine, or the workers of a dask.distributed cluster.

Both yield outcomes as they come, and stop the running jobs when the consumer stops.
"""

import logging
from collections.abc import Generator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed, wait
from pathlib import Path
from secrets import token_hex
from socket import create_connection
from typing import Any
from urllib.parse import urlsplit

from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.fleet.plan import Job
from holdfast.fleet.run import Outcome, run_job

CONNECT_S = 10


def run_locally(jobs: Sequence[Job], output: Path, workers: int) -> Generator[Outcome, None, None]:
    """Run so many jobs at a time on this machine; each is a process, watched by a thread."""
    with ThreadPoolExecutor(workers, thread_name_prefix="batch") as pool:
        yield from _outcomes(jobs, output, pool)


def run_on_cluster(jobs: Sequence[Job], output: Path, address: str) -> Generator[Outcome, None, None]:
    """Run the jobs on a cluster whose workers see the same files under the same paths.

    The client is opened and closed in a thread, and this one waits for standard futures: where Ctrl-C meets the
    client's own waiting, its loop may print a traceback.

    Raises:
        ConfigError: distributed is not installed, or no scheduler answers.
    """
    with needing("a cluster", "fleet"):
        from distributed import Client
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # it logs its own regular end as a fault
    _check_address(address)
    with ThreadPoolExecutor(1, thread_name_prefix="cluster") as thread:
        # distributed is typed in part only
        client: Any = thread.submit(Client, address, timeout=CONNECT_S, set_as_default=False).result()
        try:
            yield from _outcomes(jobs, output, client.get_executor(pure=False))
        finally:
            thread.submit(client.close).result()


def _outcomes(jobs: Sequence[Job], output: Path, pool: Executor) -> Generator[Outcome, None, None]:
    """Yield the outcomes as they come; when the consumer stops, stop the replays and wait for them."""
    stop_file = _stop_file(output)
    job_of: dict[Future[Outcome], Job] = {}
    try:
        for job in jobs:
            job_of[pool.submit(run_job, job, stop_file)] = job
        for future in as_completed(job_of):
            yield _outcome(job_of[future], future)
    except BaseException:
        stop_file.touch()
        wait(job_of)
        raise
    finally:
        stop_file.unlink(missing_ok=True)


def _check_address(address: str) -> None:
    """Refuse an address at which nobody listens; a client that cannot connect fails much later."""
    parts = urlsplit(address)
    try:
        if parts.scheme not in ("tcp", "tls") or not parts.hostname or not parts.port:
            raise ValueError("it has another form")
        create_connection((parts.hostname, parts.port), CONNECT_S).close()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"--scheduler {address}: no scheduler answers ({reason}; allowed: tcp://host:port)") from None


def _outcome(job: Job, future: "Future[Outcome]") -> Outcome:
    try:
        return future.result()
    except Exception as failure:  # whatever became of a worker or of the scheduler
        reason = f"the worker failed: {type(failure).__name__}: {failure}".splitlines()[0]
        return Outcome(job.name, "failed", job.fingerprint, reason)


def _stop_file(output: Path) -> Path:
    output.mkdir(parents=True, exist_ok=True)
    return output.resolve() / f".stop-{token_hex(4)}"
