"""Feeds never hold up who feeds them, and the recorder loses nothing silently."""

import os
import resource
import signal
import time
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from holdfast.errors import ConfigError
from holdfast.live import feed as feed_module
from holdfast.live.feed import Feed, Record
from holdfast.live.recorder import check_destination, record

EMPTY = b"\x00\x01\x00\x00\x00"


def echo(consumer, path):
    with Path(path).open("w") as file:
        for batch in consumer.batches():
            file.writelines(f"{entry.time_ns}\n" for entry in batch)


def hang(consumer):
    time.sleep(3600)


def fail(consumer):
    raise ValueError("the cat sat on it")


def batch(number, size=1, data=EMPTY):
    return [Record("/topic", "std_msgs/msg/Empty", data, number * size + k) for k in range(size)]


def log_times(path):
    with AnyReader([path]) as reader:
        return [at for _, at, _ in reader.messages()]


def test_everything_that_was_offered_arrives_in_order(tmp_path):
    feed = Feed("echo", echo, str(tmp_path / "out.txt"))
    for number in range(500):
        feed.offer(batch(number, 4))
    feed.close()
    assert [int(line) for line in (tmp_path / "out.txt").read_text().split()] == list(range(2000))
    assert feed.dropped == 0


def test_a_consumer_that_hangs_holds_nobody_up_and_what_it_misses_is_counted(monkeypatch):
    monkeypatch.setattr(feed_module, "MAX_WAITING_BATCHES", 8)
    monkeypatch.setattr(feed_module, "FINISH_S", 0.5)
    feed = Feed("hang", hang)
    slowest = 0.0
    for number in range(3000):
        began = time.perf_counter()
        feed.offer(batch(number, 1, bytes(10_000)))  # 30 MB, far more than a pipe holds
        slowest = max(slowest, time.perf_counter() - began)
    assert feed.dropped > 2000
    assert slowest < 0.25  # a scheduler's hiccup, no wait for the consumer
    feed.close()
    assert not feed.alive


def test_a_consumer_that_is_killed_holds_nobody_up(tmp_path):
    feed = Feed("echo", echo, str(tmp_path / "out.txt"))
    os.kill(feed._process.pid, signal.SIGKILL)
    feed._process.join()
    for number in range(100):
        feed.offer(batch(number))
    feed.close()
    assert feed.dropped > 0


def test_a_consumer_that_fails_says_why():
    feed = Feed("fail", fail)
    feed._process.join(30.0)
    assert feed.complaint() == "ValueError: the cat sat on it"
    assert feed.complaint() is None
    feed.close()


def test_a_consumer_ends_when_its_feeder_is_gone(tmp_path):
    out, pids = tmp_path / "out.txt", tmp_path / "pid.txt"
    child = os.fork()
    if child == 0:  # a process that feeds, and is killed
        feed = Feed("echo", echo, str(out))
        feed.offer(batch(7))
        pids.write_text(str(feed._process.pid))
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    end = time.monotonic() + 30.0
    while Path(f"/proc/{pids.read_text()}").exists() and time.monotonic() < end:
        time.sleep(0.02)
    assert not Path(f"/proc/{pids.read_text()}").exists()


def test_the_recorder_writes_what_it_is_fed(tmp_path):
    feed = Feed("recording", record, str(tmp_path / "log.mcap"))
    for number in range(100):
        feed.offer(batch(number, 3))
    feed.close()
    assert log_times(tmp_path / "log.mcap") == list(range(300))
    assert feed.complaint() is None


def record_with_little_room(consumer, path, room_bytes):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, room_bytes))
    record(consumer, path)


def test_a_full_disk_ends_the_recording_in_one_line_and_leaves_it_readable(tmp_path):
    path = tmp_path / "log.mcap"
    feed = Feed("recording", record_with_little_room, str(path), 1 << 20)
    for number in range(300):
        feed.offer(batch(number, 1, EMPTY[:4] + os.urandom(10_000)))
    feed.close()
    complaint = feed.complaint()
    assert str(path) in complaint and "the recording ends here" in complaint and "\n" not in complaint
    from holdfast.recording.source import open_recording

    with open_recording(path) as recording:
        times = [header.arrival_ns for header in recording.read_headers()]
    assert times == list(range(len(times)))
    assert len(times) > 25  # at least the chunks that had room


def test_a_log_is_never_overwritten(tmp_path):
    (tmp_path / "log.mcap").write_bytes(b"precious")
    with pytest.raises(ConfigError, match="is there already"):
        check_destination(tmp_path / "log.mcap")
    with pytest.raises(ConfigError, match="cannot be written"):
        check_destination(tmp_path / "nowhere" / "log.mcap")
    with pytest.raises(ConfigError, match=r"log\.bag: must end in \.mcap"):  # no command would have read it
        check_destination(tmp_path / "log.bag")
    check_destination(tmp_path / "new.mcap")
    assert not (tmp_path / "new.mcap").exists()
