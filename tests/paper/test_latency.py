"""The latencies of all systems come from the same messages, in one process."""

from holdfast.cli.paper import lent
from holdfast.paper.latency import WARM_UP, measure
from holdfast.paper.systems import SYSTEMS

SECONDS = 10.0


def test_every_filter_is_timed_at_every_imu_sample_but_those_with_an_update():
    found = {one.system: one for one in measure("quick", {"duration_s": SECONDS, "faults": []}, lent())}
    assert list(found) == list(SYSTEMS)
    assert found["lidar"].imu_us is None  # it has no IMU path
    for name in ("holdfast", "paper", "msf", "tsif"):
        one = found[name]
        assert one.imu_us is not None
        assert one.imu_cpu_us is not None
        assert one.update_ms is not None
        assert one.imu_us["count"] == one.imu_cpu_us["count"]
        samples = one.imu_us["count"] + one.update_ms["count"] + WARM_UP
        # 100 Hz from the start on, which takes a standstill of 1 s; the update of the start comes with a fix
        assert (SECONDS - 2.0) * 100 < samples <= SECONDS * 100
        assert 0.0 < one.imu_us["median"] <= one.imu_us["p99"] <= one.imu_us["max"]
        assert one.quantiles_us[0][1] <= one.imu_us["median"] <= one.quantiles_us[-1][1]
