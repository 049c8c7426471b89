"""Findings in plain words: one sentence per problem, what it is, where it is and what follows from it."""

from collections.abc import Iterator

from holdfast.recording.inspection import Inspection, TopicFindings
from holdfast.recording.kinds import KINDS, Kind

LATE_S = 1.0
UNSTEADY_S = 0.05


def list_problems(inspection: Inspection) -> list[str]:
    """Return the problems of a recording, those of the file first.

    Only topics that Holdfast can use are judged: many publishers on /tf are no problem.
    """
    problems = list(inspection.warnings)
    if not any(topic.kind == "imu" for topic in inspection.topics):
        problems.append(
            "no topic has readable sensor_msgs/msg/Imu messages: there is nothing to propagate an estimate with"
        )
    for topic in inspection.topics:
        if topic.kind is not None and topic.count:
            problems += [f"{topic.topic}: {problem}" for problem in topic_problems(topic)]
    return problems


def topic_problems(topic: TopicFindings) -> Iterator[str]:
    """Yield the problems of a topic that Holdfast can use."""
    if topic.kind is not None:
        yield from _gap_problems(topic, KINDS[topic.kind])
    yield from _clock_problems(topic)
    yield from _publisher_problems(topic)
    if topic.values is not None:
        yield from topic.values.problems(topic.count)


def _gap_problems(topic: TopicFindings, kind: Kind) -> Iterator[str]:
    if topic.gaps:
        yield (
            f"{topic.gaps} gap(s) longer than 5 periods, the longest {topic.longest_gap_s:.3f} s at "
            f"{topic.longest_gap_at_s:.1f} s; {kind.gap}"
        )
    if topic.burst_s is not None and topic.rate_hz is not None:
        yield (
            f"the stamps come in bursts of about {topic.burst_s * topic.rate_hz:.0f}, every {topic.burst_s:.3f} s: "
            "they are times of arrival, not of measurement; let the driver stamp by the sensor's clock"
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
            f"stamps are {topic.latency_mean_s:.3f} s from arrival on average: the clocks differ, the driver stamps "
            "wrongly, or the estimate rests on old measurements, at most 20 s old"
        )
    if topic.latency_sigma_s > UNSTEADY_S:
        yield (
            f"the latency varies by {topic.latency_sigma_s * 1e3:.0f} ms (1 sigma); if the driver stamps at "
            "arrival, the times of measurement are that uncertain"
        )


def _publisher_problems(topic: TopicFindings) -> Iterator[str]:
    consequence = "one sensor's section can only describe one of them"
    if len(topic.publishers) > 1:
        yield f"{len(topic.publishers)} publishers ({', '.join(topic.publishers)}); {consequence}"
    if len(topic.frame_ids) > 1:
        yield f"{len(topic.frame_ids)} frame_ids ({', '.join(map(repr, topic.frame_ids))}); {consequence}"
    if topic.interleaved and len(topic.publishers) == 1 and len(topic.frame_ids) == 1:
        yield f"the stamps look like those of two publishers in alternation; {consequence}"
