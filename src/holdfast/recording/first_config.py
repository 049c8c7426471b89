"""What is proposed as the first configuration of a recording, with what its first minutes tell of the sensors."""

from collections.abc import Callable, Iterator

import numpy as np

from holdfast.config.assignment import Measured, assign
from holdfast.config.proposal import Proposal, propose
from holdfast.config.starter import starter_yaml, workable
from holdfast.messages import Array
from holdfast.recording.imu_beside_receivers import imu_beside_receivers
from holdfast.recording.imu_mended import FACTORS
from holdfast.recording.inspection import TopicFindings, inspect
from holdfast.recording.kinds import KINDS
from holdfast.recording.problems import topic_problems
from holdfast.recording.recorded_frames import read_frames
from holdfast.recording.source import Recording

LOOKED_AT_S = 120.0


def first_config(recording: Recording, progress: Callable[[int], None] | None = None) -> str:
    """Return the proposal as a commented configuration that loads as it is; see `first_proposal`."""
    return starter_yaml(first_proposal(recording, progress))


def first_proposal(recording: Recording, progress: Callable[[int], None] | None = None) -> Proposal:
    """Return what is proposed for a recording; reads the first two minutes, for clocks up to five.

    Args:
        recording: an open recording.
        progress: is called with the arrival [ns] now and then.

    Raises:
        RecordingError: no topic can be the IMU, or there is no message at all.
    """
    beside = imu_beside_receivers(recording, assign(recording.topics, KINDS.values()).guesses)
    factors = {topic: _factors(one) for topic, one in beside.items() if set(FACTORS) & set(one.values)}
    inspection = inspect(recording, duration_s=LOOKED_AT_S, progress=progress, factors=factors)
    measured = {topic.topic: _measured(topic) for topic in inspection.topics if topic.kind is not None and topic.count}
    for topic, found in beside.items():
        measured[topic] = measured.get(topic, Measured()).joined(found)
    frames = read_frames(recording, LOOKED_AT_S)
    told, untold = (
        propose(str(recording.path), recording.topics, KINDS.values(), measured, of) for of in (frames, None)
    )
    return workable(told, untold)


def _factors(found: Measured) -> Array:
    """Return by what the readings (6,) of an IMU are to be multiplied."""
    return np.array([found.values.get(key, (1.0, 1.0, 1.0)) for key in FACTORS], dtype=np.float64).ravel()


def _measured(topic: TopicFindings) -> Measured:
    """Return what was found in the messages of a topic and in their values."""
    values = Measured() if topic.values is None else topic.values.measured()
    notes = (*_timing(topic), *values.notes)
    return Measured(notes, values.remarks, values.values, (*values.warnings, *topic_problems(topic)))


def _timing(topic: TopicFindings) -> Iterator[str]:
    if topic.rate_hz is None or topic.longest_gap_s is None:
        return
    text = f"measured in the first {LOOKED_AT_S:.0f} s: {topic.rate_hz:.4g} Hz, longest gap {topic.longest_gap_s:.3f} s"
    if topic.latency_mean_s is not None and topic.latency_sigma_s is not None:
        text += f", arrives {topic.latency_mean_s * 1e3:.1f} +- {topic.latency_sigma_s * 1e3:.1f} ms after its stamp"
    yield text
