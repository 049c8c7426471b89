"""What a calibration says of one number of the configuration."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple, Self

from holdfast.config.document import Path, path_text
from holdfast.config.edit import Change

SEEN = 0.5  # of the prior's sigma: what is not known better than that was not observed
CHANGED = 3.0  # sigmas from what is configured, below which it stays


class Family(StrEnum):
    """What belongs together: it is written, or left alone, as a whole."""

    CLOCKS = "clocks"
    MOUNTINGS = "mountings"
    LEVER_ARMS = "lever arms"
    SCALES = "scales of odometries"
    TURN_JOINT = "turn joint"
    IMU_NOISE = "noise of the IMU"
    FIX_NOISE = "noise of fixes and headings"
    ODOMETRY_NOISE = "noise and drift of odometries"


@dataclass(frozen=True, slots=True)
class Estimated:
    """A number, before and after.

    Attributes:
        family: with which it is written.
        path: of its key in the configuration.
        what: of which sensor, in words.
        unit: of the numbers below.
        before: as configured; of a rotation or a lever arm zero, as what follows is the difference.
        after: as measured.
        sigma: of `after`.
        prior: sigma of what was configured.
        reason: why it is not written; empty if it is.
    """

    family: Family
    path: Path
    what: str
    unit: str
    before: float
    after: float
    sigma: float
    prior: float
    reason: str = ""

    @property
    def key(self) -> str:
        """The key as people write it."""
        return path_text(self.path)

    @property
    def is_observable(self) -> bool:
        """Whether the recording says more than the configuration."""
        return self.sigma <= SEEN * self.prior

    @property
    def is_written(self) -> bool:
        """Whether it goes into the configuration."""
        return not self.reason

    def kept(self, reason: str) -> "Estimated":
        """Return it as one that is not written; a reason that it has already stays."""
        return replace(self, reason=self.reason or reason)


def judged(one: Estimated) -> Estimated:
    """Return an estimate with the reason why it is not written, if there is one."""
    if not one.is_observable:
        return one.kept(f"not observable: sigma {one.sigma:.2g} {one.unit}, the file knows it to {one.prior:.2g}")
    if abs(one.after - one.before) <= CHANGED * one.sigma:
        return one.kept("as configured")
    return one


class Found(NamedTuple):
    """What one family found: estimates, and the changes of the configuration that those of them make that are written.

    The comments of the changes are left to whoever knows the recordings.
    """

    estimates: Sequence[Estimated] = ()
    changes: Sequence[Change] = ()

    @classmethod
    def of(cls, estimates: Sequence[Estimated], digits: int) -> Self:
        """Return estimates whose keys are the numbers themselves; they are written with so many digits."""
        return cls(estimates, [Change(one.path, round(one.after, digits)) for one in estimates if one.is_written])
