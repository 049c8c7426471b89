"""Constants of sensors, from what the graph knows of them to what it knows of them after a restart."""

from collections.abc import Collection, Mapping

import numpy as np

from holdfast.config.model import Config
from holdfast.sensors.clock import GNSS_CLOCK, with_estimated_clock
from holdfast.sensors.constants import Constant, LearntConstant, carried, priors_of, priors_of_machine
from holdfast.sensors.heading import MOUNT
from holdfast.sensors.lever_arm import ARM, GNSS_ARM
from holdfast.sensors.sensor import Parameter, Sensor, part_of


def constants_of_machine(
    config: Config, sensors: Mapping[str, Sensor], doubted: Collection[str]
) -> dict[str, Parameter]:
    """Return the priors of the constants that are almost the same on the next day.

    Args:
        config: of the machine.
        sensors: the models, by name, with clocks that are estimated.
        doubted: antennas whose lever arms are in doubt: how far is not for what was learnt before to say.
    """
    priors = priors_of_machine(config, sensors)
    in_doubt = {arm.name(name) for name in doubted if (arm := part_of(sensors[name].parameters, ARM)) is not None}
    return {name: one for name, one in priors.items() if one.change is not None and name not in in_doubt}


def found_before(learnt: Mapping[str, LearntConstant], sensors: Mapping[str, Sensor]) -> dict[str, Parameter]:
    """Return where antennas were found to be before, as a shift from the models, headings and the clock; if off."""
    priors = priors_of({name: with_estimated_clock(one) for name, one in sensors.items()})
    return {
        name: carried(prior, learnt[name])
        for name, prior in priors.items()
        if name in learnt and learnt[name].is_off and (name in (GNSS_ARM, GNSS_CLOCK) or prior.part == MOUNT)
    }


def learnt_constants(constants: Mapping[str, Constant]) -> dict[str, LearntConstant]:
    """Return constants as they are kept."""
    found: dict[str, LearntConstant] = {}
    for name, one in constants.items():
        if np.isfinite(one.value).all() and np.isfinite(one.sigmas).all() and (one.sigmas > 0.0).all():
            mean, sigmas = tuple(one.value.tolist()), tuple(one.sigmas.tolist())
            found[name] = LearntConstant(mean=mean, sigmas=sigmas, is_off=one.is_off)
    return found


def carried_priors(learnt: Mapping[str, LearntConstant], priors: Mapping[str, Parameter]) -> dict[str, Parameter]:
    """Return the priors of constants that were learnt before, given what `constants_of_machine` says."""
    found: dict[str, Parameter] = {}
    for name, one in learnt.items():
        prior = priors.get(name)
        if prior is not None and len(one.mean) == len(prior.mean):
            found[name] = carried(prior, one)
    return found
