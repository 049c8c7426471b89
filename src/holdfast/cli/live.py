"""`holdfast live`: the estimator as a node of a running ROS 2 machine, without a ROS installation."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime
from multiprocessing import resource_tracker
from time import monotonic
from types import FrameType
from typing import TYPE_CHECKING

import click

from holdfast.cli import end_if_interrupted
from holdfast.cli.learnt import learnt_option
from holdfast.errors import ConfigError, EstimatorError
from holdfast.extras import needing

if TYPE_CHECKING:
    from holdfast.config.live import LiveConfig
    from holdfast.config.model import Config
    from holdfast.integrity.learnt_snapshot import LearntSnapshot
    from holdfast.live.dds import Network
    from holdfast.live.feed import Feed
    from holdfast.live.scans import LiveScans
    from holdfast.realtime.engine import RealtimeEstimator


@click.command()
@click.option("-c", "--config", "config_path", required=True, type=click.Path(), help="Configuration (YAML).")
@click.option(
    "--record", "record_path", type=click.Path(), metavar="FILE.mcap", help="Record all that is received and published."
)
@click.option(
    "--view",
    "view_target",
    is_flag=False,
    flag_value="window",
    metavar="[FILE.rrd|URL]",
    help="Show it in Rerun (extra viz): in a window, in a file, or in a viewer at rerun+http://HOST:9876/proxy.",
)
@learnt_option
@click.option("--duration", "duration_s", type=float, metavar="SECONDS", help="End after so long. [default: Ctrl-C]")
def live(
    config_path: str,
    record_path: str | None,
    view_target: str | None,
    learnt_path: str | None,
    duration_s: float | None,
) -> None:
    """Estimate on a running ROS 2 machine.

    Subscribes to the topics that the configuration names (section `live`: domain, network card, peers) and publishes
    ~/odometry/world, ~/odometry/odom, ~/odometry/base, ~/path, ~/datum, /tf, /tf_static, /diagnostics and /rosout,
    where ~ is /holdfast. With live.commands a message on ~/reset (std_msgs/Empty) makes it begin anew, one on
    ~/set_datum (sensor_msgs/NavSatFix) moves the origin of the world. Ends with Ctrl-C, its files complete.
    """
    if duration_s is not None and not duration_s > 0:
        raise ConfigError(f"--duration {duration_s:g}: must be > 0")
    from holdfast.config.load import load_config
    from holdfast.config.review import check_possible
    from holdfast.recording.subscriptions import subscriptions

    config = check_possible(load_config(config_path), config_path)
    learnt = _learnt(learnt_path, config, config_path)
    with ExitStack() as stack:
        stopped = stack.enter_context(_signals())
        network = stack.enter_context(_network(config.live))
        from holdfast.live.node import LiveNode
        from holdfast.realtime.engine import RealtimeEstimator

        with _held_back():
            feeds = _feeds(stack, record_path, view_target)
            scans = _scans(stack, config)  # before the engine ties this process to its core
            engine = stack.enter_context(RealtimeEstimator(config, learnt=learnt))
            engine.wait_until_ready()
        node = LiveNode(config, subscriptions(config), engine, network, feeds=feeds, scans=scans, show=_show)
        _show(f"listening on domain {network.domain_id}: {', '.join(node.inputs.topics)}")
        _show(f"publishing {', '.join(node.outputs.topics)}")
        gc.collect()
        end_if_interrupted()
        gc.freeze()  # looking through all that the imports have left would hold up the IMU path for tens of ms
        end = None if duration_s is None else monotonic() + duration_s
        node.run(lambda: stopped() is None and (end is None or monotonic() < end))
        why = None if node.has_started else _why_not(engine, config)
    _keep(engine, config, learnt_path if node.has_started else None)
    _end(stopped(), why)


def _learnt(path: str | None, config: "Config", config_path: str) -> "LearntSnapshot":
    """Read what was learnt before, with a warning for what does not hold any more."""
    from holdfast.calibration.learnt_file import load_learnt
    from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT
    from holdfast.output_folder import check_output_file

    if path is None:
        return NOTHING_LEARNT
    check_output_file(path, [config_path])
    learnt, warnings = load_learnt(path, config)
    for warning in warnings:
        _show(f"warning: {warning}")
    return learnt


def _keep(engine: "RealtimeEstimator", config: "Config", path: str | None) -> None:
    """Write what was learnt, and tell which keys of the configuration look wrong; the engine is closed."""
    from holdfast.calibration.learnt_file import save_learnt
    from holdfast.calibration.learnt_table import learnt_rows, wrong_lines

    learnt = engine.learnt()
    for line in wrong_lines(learnt_rows(learnt, config)):
        _show(line)
    if path is not None:
        save_learnt(path, learnt, config)


def _why_not(engine: "RealtimeEstimator", config: "Config") -> str:
    from holdfast.replay.never_started import never_started

    return never_started(engine.waiting_for, engine.counts, config)


def _end(caught: int | None, why: str | None) -> None:
    if caught is not None:
        click.echo("interrupted", err=True)
        raise SystemExit(128 + caught)
    if why is not None:
        raise EstimatorError(f"the estimator never started: {why}")


def _show(line: str) -> None:
    click.echo(f"{datetime.now().astimezone():%H:%M:%S.%f}"[:-3] + f" {line}", err=True)


def _network(live_config: "LiveConfig") -> "Network":
    with needing("holdfast live", "dds"):
        from holdfast.live.dds import Network
    return Network(live_config)


def _feeds(stack: ExitStack, record_path: str | None, view_target: str | None) -> list["Feed"]:
    from holdfast.live.feed import Feed
    from holdfast.live.recorder import check_destination, record

    wanted: list[tuple[str, Callable[..., None], tuple[object, ...]]] = []
    if record_path is not None:
        check_destination(record_path)
        wanted.append(("recording", record, (record_path,)))
    if view_target is not None:
        from holdfast.cli.view import check_target, drawing

        check_target("--view", view_target)
        wanted.append(("view", drawing("holdfast live --view").draw_live, (view_target,)))
    feeds = []
    for name, consume, arguments in wanted:
        feed = Feed(name, consume, *arguments)
        stack.callback(feed.close)
        feeds.append(feed)
    return feeds


def _scans(stack: ExitStack, config: "Config") -> "list[LiveScans]":
    """Start the odometries that are made of scans.

    Raises:
        ConfigError: the library that registers scans is not installed.
    """
    from holdfast.config.sensors import ScansConfig

    sections = config.sensors_of(ScansConfig)
    if not sections:
        return []
    from holdfast.lidar_odometry.registration import check_installed
    from holdfast.live.scans import LiveScans

    for section in sections.values():
        check_installed(section.method)
    cores = frozenset(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
    scans = []
    for name in sections:
        one = LiveScans(config, name, cores)
        stack.callback(one.close)
        scans.append(one)
    return scans


@contextmanager
def _held_back() -> Iterator[None]:
    """Hold signals back, also from what is started meanwhile: a process that still imports would end in a traceback."""
    resource_tracker.ensure_running()  # multiprocessing's own: at its start it lets signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _signals() -> Iterator[Callable[[], int | None]]:
    """Catch Ctrl-C and the end that a service manager asks for; yield a function that returns which one came."""
    caught: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        caught.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: caught[0] if caught else None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
