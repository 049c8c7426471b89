"""The KITTI drive of the gtsam wheel."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.messages import FixStatus, GnssFix, ImuSample
from holdfast.recording.kitti import DATUM
from holdfast.recording.source import Subscription, open_recording

BOTH = (Subscription("/imu", "imu", "imu"), Subscription("/gnss/fix", "gnss", "gnss"))
BAG = Path(__file__).parents[3] / "shared" / "data" / "kitti_00" / "bag"


@pytest.fixture(scope="module")
def drive():
    with open_recording("kitti") as recording:
        messages = list(recording.read(BOTH))
        assert recording.start_ns == messages[0].arrival_ns
        assert recording.end_ns == messages[-1].arrival_ns
    return messages


def enu(fix: GnssFix, datum: Geodetic):
    return LocalFrame(datum).to_enu(Geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m))


def test_the_whole_drive_is_there_in_order_of_arrival(drive) -> None:
    arrivals = [m.arrival_ns for m in drive]
    assert arrivals == sorted(arrivals)
    assert sum(isinstance(m, ImuSample) for m in drive) == 46968
    assert sum(isinstance(m, GnssFix) for m in drive) == 470
    assert {m.arrival_ns - m.stamp_ns for m in drive} == {2_000_000, 120_000_000}


def test_the_metres_of_the_file_come_back_from_the_fixes(drive) -> None:
    first = next(m for m in drive if isinstance(m, GnssFix))
    np.testing.assert_allclose(enu(first, DATUM), [-6.826936135, -11.868164241, 0.040306091], atol=1e-8)
    np.testing.assert_allclose(first.covariance, np.diag([0.0025, 0.0025, 0.01]))
    assert first.status is FixStatus.GBAS


def test_stamps_keep_every_digit_of_the_file(drive) -> None:
    first = next(m for m in drive if isinstance(m, ImuSample))
    assert first.stamp_ns == 1_317_554_000_000_000_000 + 46534_478375790
    assert first.specific_force.tolist() == [1.7114864219577, 0.1717911743144, 9.80533438749]
    assert first.angular_velocity.tolist() == [-0.0032006241515747, 0.031231284764596, -0.0063569265706488]


def test_reading_it_does_not_import_gtsam() -> None:
    import subprocess
    import sys

    code = (
        "import sys; from holdfast.recording.source import *; r = open_recording('kitti');"
        "next(r.read([Subscription('/imu', 'i', 'imu')])); sys.exit('gtsam' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.skipif(not BAG.exists(), reason="the recording kitti_00 is not beside this checkout")
def test_the_bag_of_the_same_drive_has_the_same_stamps_axes_and_places(drive) -> None:
    with open_recording(BAG) as recording:
        bag = list(recording.read(BOTH))
    samples = {round(m.stamp_ns, -3): m for m in drive if isinstance(m, ImuSample)}
    checked = 0
    for m in islice((m for m in bag if isinstance(m, ImuSample)), 0, None, 50):
        near = [samples[t] for t in (round(m.stamp_ns, -3) + d for d in (-1000, 0, 1000)) if t in samples]
        same = [s for s in near if abs(s.stamp_ns - m.stamp_ns) < 300]  # the bag's stamps went through float64
        assert len(same) == 1
        np.testing.assert_array_equal(same[0].specific_force, m.specific_force)
        np.testing.assert_array_equal(same[0].angular_velocity, m.angular_velocity)
        checked += 1
    assert checked > 900

    fixes = [m for m in drive if isinstance(m, GnssFix)]
    others = [m for m in bag if isinstance(m, GnssFix)]
    assert max(abs(a.stamp_ns - b.stamp_ns) for a, b in zip(fixes, others, strict=True)) < 300
    assert max(abs(b.arrival_ns - b.stamp_ns - 120_000_000) for b in others) < 300
    home = others[0]
    there = np.array([enu(m, Geodetic(home.latitude_deg, home.longitude_deg, home.altitude_m)) for m in others])
    here = np.array([enu(m, DATUM) for m in fixes])
    np.testing.assert_allclose(here - here[0], there - there[0], atol=2e-3)  # the two datums' axes are not parallel
