"""How the live node joins the network of the machine."""

from pydantic import Field

from holdfast.config.section import Section, quantity

NAME = r"^[A-Za-z][A-Za-z0-9_]*$"
NAMESPACE = r"^(/[A-Za-z][A-Za-z0-9_]*)*$"


class LiveConfig(Section):
    """The node of `holdfast live` on the ROS 2 network; a replay does not read it."""

    domain_id: int | None = Field(None, ge=0, le=232, description="without it ROS_DOMAIN_ID, or else 0")
    interface: str | None = Field(
        None, min_length=1, description="network card, such as eth0; without it DDS chooses one"
    )
    peers: tuple[str, ...] = Field(
        (), description="addresses at which others are looked for as well, where there is no multicast"
    )
    multicast: bool = Field(True, description="without multicast only `peers` and those who name us are found")
    node_name: str = Field("holdfast", pattern=NAME, description="the `~` of what is published: `/holdfast/path`")
    namespace: str = Field("", pattern=NAMESPACE, description="before the node's name and topics without a slash")
    commands: bool = Field(
        False, description="obey `~/reset` and `~/set_datum`, from whoever sends them on the network"
    )
    publish_tf: bool = Field(True, description="publish /tf and /tf_static; off where another node does it")
    reliable_inputs: bool = Field(
        False, description="ask for lost samples again; such a reader receives nothing from a best-effort driver"
    )
    silent_after_s: float = quantity("s", 5.0, gt=0, le=3600, doc="a topic without publisher or message is reported")
    max_clock_offset_s: float = quantity("s", 1.0, gt=0, doc="stamps further from this machine's clock are reported")
    path_step_m: float = quantity("m", 0.2, gt=0, doc="distance between two poses of the published path")
