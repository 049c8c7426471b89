"""Velocities of a GNSS receiver, by Doppler."""

from typing import Any

import numpy as np

from holdfast.config.assignment import Rule
from holdfast.messages import GnssVelocity
from holdfast.recording.columns import Columns
from holdfast.recording.decode import TWIST, TWIST_COVARIANCE, decoder, with_covariance, xyz
from holdfast.recording.kinds import COMMAND, DERIVED, INERTIAL, SATELLITE, WHEEL, Kind, register
from holdfast.recording.kinds.gnss import FIX

WORDS = (*SATELLITE, "fix_vel", "doppler", "navsat", "ublox", "septentrio", "novatel")
AVOID = (*DERIVED, *COMMAND, *WHEEL, *INERTIAL, "odom")
NO_VERTICAL = {"axes": ["x", "y"]}  # RMC and VTG sentences, of which drivers make a TwistStamped, have none


@decoder
def velocity_decoder(stamp_ns: int, arrival_ns: int, sensor: str, message: Any) -> GnssVelocity:
    """Decode geometry_msgs/TwistStamped or TwistWithCovarianceStamped: linear is east, north, up.

    Of the covariance only the linear block matters: receivers mark the angular one, and axes that they do not measure,
    by -1 or NaN.
    """
    twist, covariance = with_covariance(message.twist, "twist")
    linear = None if covariance is None or not covariance[:3, :3].any() else covariance[:3, :3]
    return GnssVelocity(stamp_ns, arrival_ns, sensor, xyz(twist.linear), linear)


def _of_line(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> GnssVelocity:
    sigmas = np.array(v[3:])
    covariance = np.diag(sigmas**2) if (sigmas > 0.0).any() else None
    return GnssVelocity(stamp_ns, arrival_ns, sensor, np.array(v[:3]), covariance)


register(
    Kind(
        "gnss_velocity",
        GnssVelocity,
        {TWIST_COVARIANCE: velocity_decoder, TWIST: velocity_decoder},
        Columns(
            ("v_east_m_s", "v_north_m_s", "v_up_m_s"),
            _of_line,
            (("sigma_v_east_m_s", "sigma_v_north_m_s", "sigma_v_up_m_s"),),
        ),
        rules=(
            Rule("gnss_velocity", WORDS, AVOID, named=True, every=True, types=(TWIST_COVARIANCE,), beside=FIX),
            Rule("gnss_velocity", WORDS, AVOID, named=True, every=True, types=(TWIST,), beside=FIX, given=NO_VERTICAL),
        ),
        gap="positions and IMU alone tell the velocity meanwhile",
        rank=45,
    )
)
