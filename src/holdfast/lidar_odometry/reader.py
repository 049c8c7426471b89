"""Finds the sweeps that can be used among the raw messages of a bag."""

from holdfast.lidar_odometry.scan_odometry import MIN_POINTS
from holdfast.lidar_odometry.sweep import Sweep, decode_sweep
from holdfast.recording.decode import UndecodableError
from holdfast.recording.merge import SkippedMessages
from holdfast.recording.raw import RawBag, RawChannel


class SweepReader:
    """Takes the messages of a bag in order; what cannot be used is counted in `skipped`.

    Raises:
        RecordingError: the definition of a type cannot be used.
    """

    def __init__(self, bag: RawBag, topic: str, min_range_m: float) -> None:
        self.skipped = SkippedMessages()
        self._min_range_m = min_range_m
        self._codecs = {channel: channel.codec() for channel in bag.channels if channel.topic == topic}
        self._last: Sweep | None = None

    def take(self, arrival_ns: int, channel: RawChannel, raw: bytes) -> Sweep | None:
        """Return the sweep that a message is, without the machine itself; None if it is none or cannot be used."""
        if channel not in self._codecs:
            return None
        try:
            return self._accept(decode_sweep(self._codecs[channel].deserialize(raw)))
        except Exception as error:  # damaged bytes raise anything; one message must not end the run
            self.skipped.add(channel.topic, arrival_ns, error)
        return None

    def _accept(self, sweep: Sweep) -> Sweep:
        last = self._last
        if last is not None and sweep.frame_id != last.frame_id:
            raise UndecodableError(f"frame_id is {sweep.frame_id!r}, before it was {last.frame_id!r}: another lidar")
        if last is not None and sweep.stamp_ns <= last.stamp_ns:
            raise UndecodableError("its stamp is not later than the one before")
        far = sweep.beyond(self._min_range_m)
        if len(far.points) < MIN_POINTS:
            raise UndecodableError(
                f"{len(far.points)} points lie beyond {self._min_range_m:g} m (allowed: {MIN_POINTS} or more)"
            )
        self._last = far
        return far
