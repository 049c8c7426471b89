"""The configuration of a replay that was given none: what `holdfast config init` can tell, said aloud."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import click
import numpy as np

from holdfast.cli.progress import reading_bar
from holdfast.errors import ConfigError

if TYPE_CHECKING:
    from holdfast.config.model import Config
    from holdfast.config.proposal import Proposal, SensorProposal
    from holdfast.recording.source import Recording

FILE = "guessed_config.yaml"


class Guessed(NamedTuple):
    """A configuration and its text, comments and all."""

    config: "Config"
    text: str


def guessed_config(recording: "Recording", output: str) -> Guessed:
    """Return what can be guessed of a recording's machine, and tell on stderr what was assumed.

    Args:
        recording: an open recording.
        output: folder of the results, where the text is going to be as `FILE`.

    Raises:
        RecordingError: there is no IMU in it.
        ConfigError: what the recording tells is no machine.
    """
    from holdfast.config.load import parse_config
    from holdfast.config.proposal import only_what_is_known
    from holdfast.config.review import impossibilities
    from holdfast.config.starter import starter_yaml
    from holdfast.recording.first_config import LOOKED_AT_S, first_proposal

    with reading_bar("guessing a configuration", recording, 0.0, LOOKED_AT_S) as progress:
        proposal = only_what_is_known(_with_what_is_installed(first_proposal(recording, progress)))
    text = starter_yaml(proposal)
    config = parse_config(text, FILE)
    if impossible := impossibilities(config):
        raise ConfigError("\n".join(f"{recording.path}: {line}, and give it with -c" for line in impossible))
    for line in assumptions(proposal, output):
        click.echo(line, err=True)
    return Guessed(config, text)


def _with_what_is_installed(proposal: "Proposal") -> "Proposal":
    """Leave out scans where the library that registers them is not there."""
    from dataclasses import replace

    from holdfast.config.sensors import ScansConfig
    from holdfast.lidar_odometry.registration import DEFAULT_METHOD, check_installed

    try:
        check_installed(DEFAULT_METHOD)
    except ConfigError as error:
        left = [
            replace(one, why_not=one.why_not or str(error)) if one.section is ScansConfig else one
            for one in proposal.sensors
        ]
        return replace(proposal, sensors=tuple(left))
    return proposal


def assumptions(proposal: "Proposal", output: str) -> Iterator[str]:
    """Yield what was assumed, one line each."""
    yield "warning: no configuration was given (-c), so this is a GUESS from what the recording holds:"
    for sensor in proposal.used:
        yield f"  {sensor.name}: {sensor.guess.topic.topic}{_where(sensor, proposal)}"
    for sensor in proposal.sensors:
        if sensor.why_not:
            yield f"  left out: {sensor.name} ({sensor.guess.topic.topic}): {sensor.why_not}"
    for warning in proposal.all_warnings:
        yield f"  {warning}"
    yield f"  noise and gates are the defaults. Go on from {output}/{FILE}: correct it and give it with -c"


def _where(sensor: "SensorProposal", proposal: "Proposal") -> str:
    mount = proposal.mount_of(sensor)
    if mount is None:
        return ""
    if mount.T is None:
        return f", ASSUMED to sit in {mount.parent} with the same axes: its mount is not in the recording"
    return f", {np.linalg.norm(mount.T[:3, 3]):.2f} m from {mount.parent} ({mount.source})"
