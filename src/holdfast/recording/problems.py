"""Findings in plain words: one sentence per problem, what it is, where it is and what follows from it."""

from collections.abc import Iterator

from holdfast.recording.decode import DECODERS
from holdfast.recording.inspection import GnssFindings, ImuFindings, Inspection, TopicFindings

USABLE_TYPES = {type_name: kind for kind, allowed in DECODERS.items() for type_name in allowed}
IMU = "sensor_msgs/msg/Imu"
LATE_S = 1.0
UNSTEADY_S = 0.05
REPEATS = 0.01
GAP_CONSEQUENCES = {
    "imu": "no IMU factor spans a gap, so lidar and GNSS must bridge it",
    "gnss": "the position drifts with the lidar odometry meanwhile",
    "lidar": "IMU and GNSS alone carry the estimate meanwhile",
    "heading": "the gyroscope carries the heading meanwhile",
    "joint": "the base state is interpolated over it",
}


def list_problems(inspection: Inspection) -> list[str]:
    """Return the problems of a recording, those of the file first.

    Only topics that Holdfast can use are judged: many publishers on /tf are no problem.
    """
    problems = list(inspection.warnings)
    if not any(topic.imu for topic in inspection.topics):
        problems.append(
            "no topic has readable sensor_msgs/msg/Imu messages: there is nothing to propagate an estimate with"
        )
    for topic in inspection.topics:
        if topic.type in USABLE_TYPES and topic.count:
            kind = USABLE_TYPES[topic.type] if topic.type != IMU else "heading" if topic.imu is None else "imu"
            problems += [f"{topic.topic}: {problem}" for problem in _topic_problems(topic, kind)]
    return problems


def _topic_problems(topic: TopicFindings, kind: str) -> Iterator[str]:
    yield from _gap_problems(topic, kind)
    yield from _clock_problems(topic)
    yield from _publisher_problems(topic)
    if topic.imu is not None:
        yield from _imu_problems(topic.imu, topic.count)
    if topic.gnss is not None:
        yield from _gnss_problems(topic.gnss, topic.count)


def _gap_problems(topic: TopicFindings, kind: str) -> Iterator[str]:
    if topic.gaps:
        yield (
            f"{topic.gaps} gap(s) longer than 5 periods, the longest {topic.longest_gap_s:.3f} s at "
            f"{topic.longest_gap_at_s:.1f} s; {GAP_CONSEQUENCES[kind]}"
        )


def _clock_problems(topic: TopicFindings) -> Iterator[str]:
    if topic.stamps_back:
        yield f"{topic.stamps_back} stamp(s) jump back; such samples come too late to be used, check the driver's clock"
    if topic.duplicate_stamps:
        yield f"{topic.duplicate_stamps} stamp(s) occur twice; the second measurement of one instant adds nothing"
    if topic.arrived_before_stamp:
        yield (
            f"{topic.arrived_before_stamp} of {topic.count} messages arrived before their stamp; the sensor's clock is "
            "ahead of the recorder's: synchronise them (PTP) or set time_offset_s"
        )
    if topic.latency_mean_s is None or topic.latency_sigma_s is None:
        return
    if abs(topic.latency_mean_s) > LATE_S:
        yield (
            f"stamps are {topic.latency_mean_s:.3f} s from arrival on average; measurements later than graph.lag_s are "
            "dropped: the clocks differ, or the driver stamps wrongly"
        )
    if topic.latency_sigma_s > UNSTEADY_S:
        yield (
            f"the latency spreads by {topic.latency_sigma_s * 1e3:.0f} ms (1 sigma); if the driver stamps at "
            "arrival, the times of measurement are that uncertain"
        )


def _publisher_problems(topic: TopicFindings) -> Iterator[str]:
    consequence = "one sensor's section can only describe one of them"
    if len(topic.publishers) > 1:
        yield f"{len(topic.publishers)} publishers ({', '.join(topic.publishers)}); {consequence}"
    if len(topic.frame_ids) > 1:
        yield f"{len(topic.frame_ids)} frame_ids ({', '.join(map(repr, topic.frame_ids))}); {consequence}"
    if topic.interleaved and len(topic.publishers) == 1 and len(topic.frame_ids) == 1:
        yield f"the stamps look like two publishers that take turns; {consequence}"


def _imu_problems(imu: ImuFindings, count: int) -> Iterator[str]:
    if imu.repeats > REPEATS * count:
        yield (
            f"{imu.repeats} of {count} samples ({imu.repeats / count:.0%}) repeat the one before; the sensor measures "
            "less often than it is read, so its true rate is lower"
        )
    if imu.lines:
        yield (
            f"{imu.lines} straight line(s) through all six channels, {imu.line_samples} samples, the longest "
            f"{imu.longest_line_s:.3f} s at {imu.longest_line_at_s:.1f} s; a logger drew them over drop-outs, "
            "nothing was measured there"
        )
    if imu.not_finite:
        yield f"{imu.not_finite} sample(s) are not finite; they are counted and not used"


def _gnss_problems(gnss: GnssFindings, count: int) -> Iterator[str]:
    if gnss.unknown_covariances:
        yield (
            f"{gnss.unknown_covariances} of {count} fixes have no covariance; they need default_sigma_m or are refused"
        )
    if gnss.not_finite:
        yield f"{gnss.not_finite} of {count} fixes have no finite position; they are counted and not used"
    if "gbas" not in gnss.statuses:
        statuses = ", ".join(gnss.statuses)
        yield f"no fix has the status gbas (only {statuses}); RTK was never fixed, or the driver does not tell"
