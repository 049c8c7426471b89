"""The latencies of all systems come from the same messages, in one process."""

from holdfast.paper.latency import WARM_UP_SAMPLES, measure
from holdfast.paper.systems import ENGINE, SYSTEMS

SECONDS = 6.0


def test_every_system_is_timed_at_every_imu_sample_with_and_without_those_that_have_an_update():
    found = {one.system: one for one in measure("quick", {"duration_s": SECONDS, "faults": []})}
    assert list(found) == [*SYSTEMS, ENGINE]
    assert found["lidar"].imu_us is None  # it has no IMU path
    for name in ("holdfast", "paper", "msf", "tsif", ENGINE):
        one = found[name]
        assert one.imu_us is not None
        assert one.imu_cpu_us is not None
        assert one.update_ms is not None
        assert one.every_cpu_us is not None
        assert one.imu_us["count"] == one.imu_cpu_us["count"]
        # 100 Hz from the start on, which takes a standstill of 1 s
        assert (SECONDS - 2.0) * 100 < one.every_cpu_us["count"] + WARM_UP_SAMPLES <= SECONDS * 100
        with_update = one.every_cpu_us["count"] - one.imu_us["count"]
        assert one.update_ms["count"] > 20  # there are 20 fixes a second
        if name == ENGINE:
            assert with_update == 0  # no sample waits for the optimiser
        else:
            assert 20 < with_update <= one.update_ms["count"]
            assert one.every_cpu_us["mean"] > one.imu_cpu_us["mean"]
        assert 0.0 < one.imu_us["median"] <= one.imu_us["p99"] <= one.imu_us["max"]
        assert one.quantiles_us[0][1] <= one.imu_us["median"] <= one.quantiles_us[-1][1]
