"""A machine's network on the loopback card, and real ROS 2 environments to talk to."""

import fcntl
import os
import random
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from network import LiveProcess

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "recording"))  # its bags serve here too


@pytest.fixture
def domain():
    """A domain on which nobody talks; its ports lie below those that the system hands out."""
    for number in random.SystemRandom().sample(range(1, 101), 100):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7410 + 250 * number))
            except OSError:
                continue
            return number
    raise AssertionError("no domain is free")


@pytest.fixture
def live(domain, tmp_path):
    """Starts `holdfast live` on the domain; what is left of it is ended."""
    started = []

    def start(*arguments, **settings):
        process = LiveProcess(tmp_path, domain, *arguments, **settings)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()


@pytest.fixture(scope="session")
def ros_python():
    """Return a function that gives the interpreter of a ROS 2 distribution, installed once into the user's cache.

    Without a registry the tests fail, because nothing else shows that ROS understands us; who works without one sets
    HOLDFAST_NO_ROS=1.
    """

    def interpreter(distribution):
        if os.environ.get("HOLDFAST_NO_ROS"):
            pytest.skip("HOLDFAST_NO_ROS is set")
        if not sys.platform.startswith("linux") or os.uname().machine != "x86_64" or sys.version_info >= (3, 14):
            pytest.skip("the wheels of rclpy are for Linux on x86_64 and Python up to 3.13")
        requirements = HERE / "peer" / f"{distribution}.txt"
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "holdfast-tests"
        cache.mkdir(parents=True, exist_ok=True)
        folder = cache / f"{distribution}-{sys.version_info.major}.{sys.version_info.minor}"
        with (cache / f"{folder.name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # another worker may be at it
            _install(folder, requirements)
        return folder / "bin" / "python"

    return interpreter


def _install(folder, requirements):
    done = folder / "installed.txt"
    if done.exists() and done.read_text() == requirements.read_text():
        return
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "-q"]
    installed = subprocess.run([*pip, "-r", str(requirements)], capture_output=True, text=True, check=False)
    assert installed.returncode == 0, installed.stderr
    done.write_text(requirements.read_text())
