"""The schedulers of jobs: processes on this machine, or the workers of a dask.distributed cluster.

Both yield outcomes as they come, and stop the running jobs when the consumer stops.
"""

import logging
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from secrets import token_hex
from socket import create_connection
from urllib.parse import urlsplit

from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.fleet.plan import Job
from holdfast.fleet.run import Outcome, run_job

CONNECT_S = 10


def run_locally(jobs: Sequence[Job], output: Path, workers: int) -> Generator[Outcome, None, None]:
    """Run so many jobs at a time on this machine; each is a process, watched by a thread."""
    stop_file = _stop_file(output)
    with ThreadPoolExecutor(workers, thread_name_prefix="batch") as pool:
        futures = [pool.submit(run_job, job, stop_file) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            stop_file.touch()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
        finally:
            stop_file.unlink(missing_ok=True)


def run_on_cluster(jobs: Sequence[Job], output: Path, address: str) -> Generator[Outcome, None, None]:
    """Run the jobs on a cluster whose workers see the same files under the same paths.

    Raises:
        ConfigError: distributed is not installed, or no scheduler answers.
    """
    with needing("a cluster", "fleet"):
        from distributed import Client
        from distributed import as_completed as as_completed_there
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # it logs its own regular end as a fault
    _check_address(address)
    stop_file = _stop_file(output)
    # distributed is typed in part only
    with Client(address, timeout=CONNECT_S, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        futures = [client.submit(run_job, job, stop_file, pure=False) for job in jobs]
        job_of = dict(zip((future.key for future in futures), jobs, strict=True))
        try:
            for future in as_completed_there(futures, loop=client.loop):  # type: ignore[no-untyped-call]
                job = job_of[future.key]
                failure = future.exception()
                yield future.result() if failure is None else _lost(job, failure)
        except BaseException:
            stop_file.touch()
            client.gather([future for future in futures if future.status == "pending"], errors="skip")
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


def _lost(job: Job, failure: BaseException) -> Outcome:
    reason = f"the worker failed: {type(failure).__name__}: {failure}".splitlines()[0]
    return Outcome(job.name, "failed", job.fingerprint, reason)


def _stop_file(output: Path) -> Path:
    output.mkdir(parents=True, exist_ok=True)
    return output.resolve() / f".stop-{token_hex(4)}"
