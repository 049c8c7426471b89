"""What happens to messages on their way, and to the sensors that send them."""

from dataclasses import replace

import numpy as np
from motion import ns, seconds


def late(messages, delays_s):
    """The same messages, each arriving later."""
    return [replace(m, arrival_ns=m.arrival_ns + round(d * 1e9)) for m, d in zip(messages, delays_s, strict=True)]


def swung(samples, since_s=0.0, until_s=np.inf, amplitude_m_s2=3.0, hz=0.55):
    """Samples of an engine that turns nearly as often as the IMU measures: a swing that the machine does not make."""
    for one in samples:
        t = seconds(one.stamp_ns)
        phase = 2.0 * np.pi * hz * t
        swing = amplitude_m_s2 * np.array([np.sin(phase), np.cos(phase), 0.3 * np.sin(phase)])
        yield replace(one, specific_force=one.specific_force + swing) if since_s <= t < until_s else one


def jumped_gyroscope(samples, at_s, by_deg_s):
    """Samples of a gyroscope whose bias about the vertical axis jumps."""
    by = np.radians([0.0, 0.0, by_deg_s])
    return [
        replace(one, angular_velocity=one.angular_velocity + by) if one.stamp_ns > ns(at_s) else one for one in samples
    ]
