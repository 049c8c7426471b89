"""Constants of sensors, from what the graph knows of them to what it knows of them after a restart."""

from collections.abc import Collection, Mapping

import numpy as np

from holdfast.config.model import Config
from holdfast.messages import Array
from holdfast.sensors.constants import (
    ARM_M,
    RATIO,
    Constant,
    LearntConstant,
    arms_of,
    carried,
    change_of,
    priors_of,
    priors_of_imu,
)
from holdfast.sensors.sensor import Parameter, Sensor


def constants_of_machine(config: Config, sensors: Mapping[str, Sensor], doubted: Collection[str]) -> dict[str, Array]:
    """Return the constants that are the same on the next day, each (p,) with how much it may have changed.

    Args:
        config: of the machine.
        sensors: the models, by name, with clocks that are estimated.
        doubted: antennas whose lever arms are in doubt: how far is not for what was learnt before to say.
    """
    found = {name: np.full(len(prior.mean), RATIO) for name, prior in priors_of_imu(config).items()}
    for name, sensor in sensors.items():
        change = change_of(sensor)
        if change is not None and name not in doubted:
            found.update((constant, change) for constant in priors_of({name: sensor}))
        found.update((constant, np.full(3, ARM_M)) for constant in arms_of({name: sensor}))
    return found


def learnt_constants(constants: Mapping[str, Constant]) -> dict[str, LearntConstant]:
    """Return constants as they are kept."""
    found: dict[str, LearntConstant] = {}
    for name, one in constants.items():
        if np.isfinite(one.value).all() and np.isfinite(one.sigmas).all() and (one.sigmas > 0.0).all():
            mean, sigmas = tuple(one.value.tolist()), tuple(one.sigmas.tolist())
            found[name] = LearntConstant(mean=mean, sigmas=sigmas, is_off=one.is_off)
    return found


def carried_priors(
    learnt: Mapping[str, LearntConstant], priors: Mapping[str, Parameter], changes: Mapping[str, Array]
) -> dict[str, Parameter]:
    """Return the priors of constants that were learnt before.

    Args:
        learnt: by name.
        priors: what the configuration says.
        changes: what `constants_of_machine` says.
    """
    found: dict[str, Parameter] = {}
    for name, one in learnt.items():
        if name in priors and name in changes and len(one.mean) == len(priors[name].mean):
            mean, sigmas = np.array(one.mean), np.array(one.sigmas)
            found[name] = carried(priors[name], mean, sigmas, changes[name], is_off=one.is_off)
    return found
