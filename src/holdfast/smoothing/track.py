"""The track between the nodes of the optimum: the IMU carries each node on to the next.

Where it arrives a little beside the next node, the difference is spread over the link in proportion to time, so the
track passes through every node.
"""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

from holdfast.graph.batch import Batch
from holdfast.graph.nodes import Link
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import integrate, preintegration_params
from holdfast.smoothing.block import Track

UNIT_NOISE = 1e-3  # of a preintegration of which only the mean is used


def track_of(buffer: ImuBuffer, batch: Batch, links: Sequence[Link], gravity: float) -> Track:
    """Return the states at the samples of the IMU over some links."""
    params = preintegration_params(UNIT_NOISE, UNIT_NOISE, UNIT_NOISE, gravity)
    times: list[int] = []
    navs: list[gtsam.NavState] = []
    from_imu: list[bool] = []
    for link in links:
        nav, end = (batch.nav(key) for key in link.keys)
        stamps = buffer.stamps_between(link.start_ns - 1, link.end_ns)
        if link.is_gap:
            carried, rest = [nav] * len(stamps), nav.localCoordinates(end)
        else:
            pim = gtsam.PreintegratedImuMeasurements(params, batch.bias(link.bias_key))
            carried = _carried(buffer, pim, nav, link)
            rest = carried[-1].localCoordinates(end)
            carried = carried[stamps[:1] != [link.start_ns] :]
        length_ns = link.end_ns - link.start_ns
        times += stamps
        navs += [
            one.retract((stamp - link.start_ns) / length_ns * rest)
            for stamp, one in zip(stamps, carried, strict=False)  # the last of those carried is at the next node
        ]
        from_imu += [not link.is_gap] * len(stamps)
    return _track(times, navs, from_imu)


def _carried(
    buffer: ImuBuffer, pim: gtsam.PreintegratedImuMeasurements, nav: gtsam.NavState, link: Link
) -> list[gtsam.NavState]:
    """Return the node and the states after each step of the IMU from it to the next."""
    bias = pim.biasHat()
    bias_accel, bias_gyro = bias.accelerometer(), bias.gyroscope()
    carried = [nav]
    for step in buffer.steps(link.start_ns, link.end_ns):
        integrate(pim, step, bias_accel, bias_gyro)
        carried.append(pim.predict(nav, bias))
    return carried


def _track(times: list[int], navs: list[gtsam.NavState], from_imu: list[bool]) -> Track:
    positions = np.array([nav.position() for nav in navs]).reshape(-1, 3)
    velocities = np.array([nav.velocity() for nav in navs]).reshape(-1, 3)
    quaternions = np.array([_xyzw(nav) for nav in navs]).reshape(-1, 4)
    return Track(
        np.array(times, dtype=np.int64), positions, quaternions, velocities, np.array(from_imu, dtype=np.bool_)
    )


def _xyzw(nav: gtsam.NavState) -> Array:
    q: Any = nav.attitude().toQuaternion()
    values = np.array([q.x(), q.y(), q.z(), q.w()])
    return values if values[3] >= 0.0 else -values
