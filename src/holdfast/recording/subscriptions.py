"""Which topics of a recording feed which sensors: what the configuration asks of a recording."""

from pydantic import BaseModel

from holdfast.config.model import BaseImuConfig, Config, GnssConfig, HeadingConfig, ImuConfig, JointConfig, LidarConfig
from holdfast.recording.source import Kind, Subscription

KINDS: dict[type[BaseModel], Kind] = {
    ImuConfig: "imu",
    BaseImuConfig: "imu",
    GnssConfig: "gnss",
    LidarConfig: "lidar",
    HeadingConfig: "heading",
    JointConfig: "joint",
}


def subscriptions(config: Config) -> list[Subscription]:
    """Return one subscription per configured sensor, in the model's order; messages carry the sensor's field name."""
    found = []
    for name in type(config.sensors).model_fields:
        section = getattr(config.sensors, name)
        if section is not None:
            joint_name = getattr(section, "joint_name", None)
            kind = KINDS[type(section)]
            found.append(Subscription(topic=section.topic, sensor=name, kind=kind, joint_name=joint_name))
    return found
