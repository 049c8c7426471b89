"""What is learnt at the turn joint, as plain numbers: carried over a restart, and into the next day."""

from math import tau
from typing import Self

from pydantic import Field, model_validator

from holdfast.config.section import Section
from holdfast.sensors.constants import LearntConstant


class LearntJoint(Section):
    """What is learnt of the encoder and of the inertial measurement units above and below it, where something was.

    A yaw of either unit cannot be told from the zero: `zero` is the sum, and its sigma that of the sum.
    """

    zero: LearntConstant | None = Field(
        None, description="(1,) to be added to the angle, beside `zero_offset_deg` [rad]"
    )
    cabin_tilt: LearntConstant | None = Field(None, description="(2,) of the cabin's unit about x and y of A [rad]")
    base_tilt: LearntConstant | None = Field(None, description="(2,) of the chassis' unit about x and y of J [rad]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, size in (("zero", 1), ("cabin_tilt", 2), ("base_tilt", 2)):
            one: LearntConstant | None = getattr(self, name)
            if one is not None and len(one.mean) != size:
                raise ValueError(f"{name}: must have {size} numbers in mean")
            if one is not None and max(map(abs, one.mean + one.sigmas)) > tau:
                raise ValueError(f"{name}: must be within +-{tau:.2f} rad")
        return self


NOTHING_OF_JOINT = LearntJoint()
