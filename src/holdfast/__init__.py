"""Holdfast tells a construction machine where it is: IMU, RTK-GNSS and lidar odometry fused in factor graphs.

```python
with holdfast.RealtimeEstimator(holdfast.load_config("machine.yaml")) as estimator:
    output = estimator.add_imu(stamp_ns, angular_velocity, specific_force)
```
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from holdfast.api.calibration import Calibration as Calibration
    from holdfast.api.calibration import calibrate as calibrate
    from holdfast.api.result import Result as Result
    from holdfast.api.run import replay as replay
    from holdfast.api.run import smooth as smooth
    from holdfast.api.simulation import Simulated as Simulated
    from holdfast.api.simulation import simulate as simulate
    from holdfast.api.trajectory import Errors as Errors
    from holdfast.api.trajectory import Trajectory as Trajectory
    from holdfast.config.load import load_config as load_config
    from holdfast.config.model import Config as Config
    from holdfast.errors import ConfigError as ConfigError
    from holdfast.errors import EstimatorError as EstimatorError
    from holdfast.errors import HoldfastError as HoldfastError
    from holdfast.errors import MessageError as MessageError
    from holdfast.errors import RecordingError as RecordingError
    from holdfast.estimator.estimator import Estimator as Estimator
    from holdfast.events import Event as Event
    from holdfast.events import Health as Health
    from holdfast.geometry.earth import Geodetic as Geodetic
    from holdfast.messages import FixStatus as FixStatus
    from holdfast.messages import GnssFix as GnssFix
    from holdfast.messages import Heading as Heading
    from holdfast.messages import ImuSample as ImuSample
    from holdfast.messages import JointAngle as JointAngle
    from holdfast.messages import SensorPose as SensorPose
    from holdfast.realtime.engine import RealtimeEstimator as RealtimeEstimator
    from holdfast.state import BaseState as BaseState
    from holdfast.state import Estimate as Estimate
    from holdfast.state import Output as Output

__version__ = "0.1.0"

# name -> module; imported when it is first asked for, so that `import holdfast` costs nothing
_PUBLIC = {
    "BaseState": "state",
    "Calibration": "api.calibration",
    "Config": "config.model",
    "ConfigError": "errors",
    "Estimate": "state",
    "Estimator": "estimator.estimator",
    "EstimatorError": "errors",
    "Errors": "api.trajectory",
    "Event": "events",
    "FixStatus": "messages",
    "Geodetic": "geometry.earth",
    "GnssFix": "messages",
    "Heading": "messages",
    "Health": "events",
    "HoldfastError": "errors",
    "ImuSample": "messages",
    "JointAngle": "messages",
    "MessageError": "errors",
    "SensorPose": "messages",
    "Output": "state",
    "RealtimeEstimator": "realtime.engine",
    "RecordingError": "errors",
    "Result": "api.result",
    "Simulated": "api.simulation",
    "Trajectory": "api.trajectory",
    "calibrate": "api.calibration",
    "load_config": "config.load",
    "replay": "api.run",
    "simulate": "api.simulation",
    "smooth": "api.run",
}
__all__ = ["__version__", *_PUBLIC]  # noqa: PLE0604 (names)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'holdfast' has no attribute {name!r}")
    if name == "replay":  # the package of that name, which can be called
        return import_module("holdfast.replay")
    value = getattr(import_module(f"holdfast.{_PUBLIC[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
