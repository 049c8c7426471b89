"""How the realtime engine divides the machine between its two processes."""

from pydantic import Field

from holdfast.config.section import Section, quantity


class RealtimeConfig(Section):
    """The two processes of the realtime engine; a replay in one process reads `max_rate_hz` alone."""

    hang_s: float = quantity("s", 3.0, ge=0.5, le=60, doc="an optimiser silent for so long is killed and started anew")
    max_rate_hz: float = quantity(
        "Hz", 200.0, ge=1, doc="of more measurements of a sensor so many are taken in, in a replay too; of an IMU all"
    )
    optimiser_core: int | None = Field(None, ge=0, description="core of the optimiser; without it any")
    optimiser_nice: int = Field(0, ge=0, le=19, description="by how much the optimiser yields to others")
    imu_core: int | None = Field(None, ge=0, description="core of the thread that makes the engine; without it any")
    imu_priority: int = Field(
        0, ge=0, le=99, description="real-time priority (SCHED_FIFO) of that thread; needs CAP_SYS_NICE"
    )
