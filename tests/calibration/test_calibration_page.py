"""The words of the page about a calibration."""

import pytest

from holdfast.calibration.calibrate import Calibration
from holdfast.calibration.estimated import Estimated, Family
from holdfast.config.model import Config

pytest.importorskip("plotly", reason="plotly is not installed (extra `report`)")

from holdfast.calibration.page import calibration_page


def test_a_family_of_numbers_is_headed_by_its_own_name():
    config = Config(
        sensors={"imu": {"kind": "imu", "topic": "/imu"}, "gnss": {"kind": "gnss", "topic": "/fix", "frame": "imu"}}
    )
    path = ("sensors", "imu", "gyroscope_noise_density")
    noise = Estimated(Family.IMU_NOISE, path, "imu", "rad/s/sqrt(Hz)", 1e-4, 2e-4, 1e-6, 1e-4)
    found = Calibration(config, config, "", [noise], [], ["drive"], 1, None)
    titles = [getattr(block, "title", "") for block in calibration_page(found, "holdfast calibrate").sections[0].blocks]
    assert "Noise of the IMU" in titles
