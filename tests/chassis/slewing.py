"""A cabin that slews on a chassis whose motion is known, in closed form or by the simulator, and its perfect estimates.

The estimates are the truth about the cabin's IMU, so that what is wrong with the chassis is the chassis' own error.
"""

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import gtsam
import numpy as np
from alone import alone

from holdfast.chassis.kinematics import BaseKinematics
from holdfast.config.model import Config
from holdfast.event_log import EventLog
from holdfast.kernel import turn_joint
from holdfast.kernel.imu_path import NO_ENCODER
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT
from holdfast.sim.configuration import configuration
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import START_NS, simulate
from holdfast.state import PUBLISHED, BaseState, Estimate

at = alone(turn_joint.at)

NO_BIAS = gtsam.imuBias.ConstantBias()
NO_COVARIANCE = np.zeros((9, 9))
AT_REST = np.array([0.0, 0.0, 9.81])

# an axis that is not the z axis of B, through a point off the origin, and a cabin that sits askew at zero
T_B_P = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.2, -0.3, 0.8), np.array([0.4, -0.2, 0.3]))
T_P_C0 = gtsam.Pose3(gtsam.Rot3.RzRyRx(-0.1, 0.15, 0.5), np.array([0.1, 0.3, 1.15]))
T_C_I = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.4, -0.7, 1.1), np.array([0.25, -0.35, 0.12]))
T_B_BI = gtsam.Pose3(gtsam.Rot3.RzRyRx(1.2, 0.3, -0.5), np.array([0.4, 0.2, 0.75]))
T_W_O = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.02, 0.3), np.array([3.0, -2.0, 0.5]))


def ns(t):
    return START_NS + round(t * 1e9)


def mount(parent, child, T):
    rotation = tuple(tuple(row) for row in T.rotation().matrix().tolist())
    return {"parent": parent, "child": child, "translation_m": T.translation().tolist(), "rotation_matrix": rotation}


def machine(base_imu=True, imu=None, joint=None):
    """Configuration of the machine askew; keyword arguments change its sections."""
    quiet = {"accelerometer_error_ratio": 0.0, "gyroscope_error_ratio": 0.0}
    sensors = {"imu": {"kind": "imu", "topic": "/imu", **quiet, **(imu or {})}}
    sensors["joint"] = {"kind": "joint", "topic": "/joint", "noise_deg": 1e-3, **(joint or {})}
    if base_imu:
        sensors["base_imu"] = {"kind": "base_imu", "topic": "/base_imu"}
    return Config.model_validate(
        {
            "sensors": sensors,
            "extrinsics": [
                mount("cabin", "imu", T_C_I),
                mount("base_link", "ring", T_B_P),
                mount("base_link", "base_imu", T_B_BI),
            ],
            "turn_joint": mount("ring", "cabin", T_P_C0),
        }
    )


@dataclass(frozen=True)
class Machine:
    """The chassis moves with a constant twist in B: `omega` [rad/s] and `velocity` [m/s]; the cabin sways on it."""

    omega: np.ndarray
    velocity: np.ndarray
    swing_rad: float = 1.5

    def angle(self, t):
        return self.swing_rad * np.sin(0.5 * t) + 0.3

    def angle_rate(self, t):
        return 0.5 * self.swing_rad * np.cos(0.5 * t)

    def T_W_B(self, t):
        return gtsam.Pose3.Expmap(np.concatenate([self.omega, self.velocity]) * t)

    def T_W_I(self, t):
        turned = gtsam.Pose3(gtsam.Rot3.Rz(self.angle(t)), np.zeros(3))
        at_joint = T_B_P * gtsam.Pose3(gtsam.Rot3(), T_P_C0.translation())
        return self.T_W_B(t) * at_joint * turned * gtsam.Pose3(T_P_C0.rotation(), np.zeros(3)) * T_C_I

    def estimate(self, t):
        """The truth about I, by differences of poses."""
        T, h = self.T_W_I(t), 1e-5
        v_W = (self.T_W_I(t + h).translation() - self.T_W_I(t - h).translation()) / (2.0 * h)
        rate = gtsam.Rot3.Logmap(self.T_W_I(t - h).rotation().between(self.T_W_I(t + h).rotation())) / (2.0 * h)
        nav = gtsam.NavState(T.rotation(), T.translation(), v_W)
        return Estimate.of(ns(t), nav, T_W_O, NO_BIAS, NO_COVARIANCE, rate, True)

    def reading(self, t, delay_s=0.004):
        return JointAngle(ns(t), ns(t + delay_s), "joint", float(self.angle(t)))

    def base_sample(self, t, delay_s=0.001, bias=0.0):
        """What the base IMU measures; the bias is about the axis of the joint."""
        about = T_B_P.rotation().rotate(np.array([0.0, 0.0, bias]))
        return ImuSample(ns(t), ns(t + delay_s), "base_imu", T_B_BI.rotation().unrotate(self.omega + about), AT_REST)


DRIVING = Machine(np.array([0.05, -0.08, 0.3]), np.array([1.2, -0.1, 0.2]))
TIMES = np.arange(0.0, 12.0, 0.01)
MAX_ATTITUDE_DEG, MAX_POSITION_M, MAX_YAW_RATE_RAD_S = 0.1, 0.015, 0.005


def estimates(motion, times=TIMES):
    return [motion.estimate(t) for t in times]


def received(motion, times=TIMES, joint_s=0.004, base_s=0.001, bias=0.0):
    """Encoder and base IMU at 100 Hz, measured 3 and 6 ms after the cabin's samples."""
    return [motion.reading(t + 0.003, joint_s) for t in times] + [
        motion.base_sample(t + 0.006, base_s, bias) for t in times
    ]


def chassis_at(base, estimate, force=AT_REST):
    """The chassis at an estimate, as the kernel of the IMU path asks for it, with the specific force of its sample."""
    mount, joint, rotations, waiting = base.records
    values = estimate.values.copy()
    row = values.view(PUBLISHED)[0]
    known = mount[0], joint, rotations, waiting, row["estimate"], row["chassis"]
    is_known = at(*known, estimate.stamp_ns, estimate.from_imu, force)
    base.count()
    encoder = base.note(estimate.stamp_ns, int(joint[0]["encoder"]) if mount[0]["has_joint"] else NO_ENCODER)
    return BaseState(estimate.stamp_ns, values, encoder) if is_known else None


class Chassis:
    """`BaseKinematics` with a log of its own."""

    def __init__(self, config, learnt=NOTHING_OF_JOINT):
        self.log = EventLog("imu")
        self.base = BaseKinematics(config, self.log, learnt)

    @property
    def counts(self):
        self.base.count()
        return self.log.counts

    def run(self, estimates, messages, forces=None):
        """Feed both in the order of arrival, an estimate arriving 1 ms after its stamp; return all states.

        Args:
            estimates: of the cabin.
            messages: of encoder and base IMU.
            forces: (N, 3) specific force of each estimate's sample [m/s^2].
        """
        of_stamps = {} if forces is None else {e.stamp_ns: f for e, f in zip(estimates, forces, strict=True)}
        rows = [(e.stamp_ns + 1_000_000, 0, e) for e in estimates] + [(m.arrival_ns, 1, m) for m in messages]
        imu_arrival_ns, states = 0, []
        for arrival_ns, _, row in sorted(rows, key=lambda row: row[:2]):
            if isinstance(row, Estimate):
                imu_arrival_ns = arrival_ns
                states.append(chassis_at(self.base, row, of_stamps.get(row.stamp_ns, AT_REST)))
            else:
                self.base.add(row, imu_arrival_ns)
        return states

    def encoder_states(self):
        """When the encoder's state changed to what: seconds and text."""
        return [((event.stamp_ns - START_NS) * 1e-9, event.reason) for event in self.log.events]


SLEWS = [
    {"stand_s": 2.0},
    {"slew_to_deg": 200.0},
    {"slew_to_deg": 0.0},
    {"drive_to_m": [[4.0, 2.0], [7.0, 1.0]]},
    {"slew_to_deg": 120.0},
]


@dataclass(frozen=True)
class Errors:
    """What is wrong with the chassis at each estimate, (N, ...), the cabin's own error left out."""

    times_s: np.ndarray
    attitude_rad: np.ndarray
    position_m: np.ndarray
    rate_rad_s: np.ndarray
    velocity_m_s: np.ndarray
    angle_rad: np.ndarray
    slew_rad_s: np.ndarray
    states: list

    def during(self, mask):
        columns = {field.name: getattr(self, field.name)[mask] for field in fields(self) if field.name != "states"}
        return replace(self, states=[], **columns)

    def between(self, start_s, end_s):
        return self.during((self.times_s >= start_s) & (self.times_s < end_s))


def rms(errors):
    """Root of the mean square; of vectors, of their norms."""
    squares = errors**2 if errors.ndim == 1 else (errors**2).sum(axis=1)
    return float(np.sqrt(squares.mean()))


def slewing(*faults, **overrides):
    """A scenario: 40 s of slewing at 0.6 rad/s, driving in between; the zero of the encoder is known."""
    return load_scenario("quick", {"duration_s": 40.0, "activities": SLEWS, "faults": list(faults), **overrides})


def messages_of(simulation, *names):
    found = []
    for name in names:
        delivered = simulation.delivered[name]
        values = delivered.readings.values
        stamps = zip(delivered.stamps_ns.tolist(), delivered.arrivals_ns.tolist(), strict=True)
        for row, (stamp, arrival) in enumerate(stamps):
            if name == "joint":
                found.append(JointAngle(stamp, arrival, name, float(values["angle_rad"][row])))
            else:
                found.append(
                    ImuSample(stamp, arrival, name, values["angular_velocity"][row], values["specific_force"][row])
                )
    return found


def encoder_zero_rad(simulation):
    return simulation.measured["joint"].constants["zero_offset_rad"]


def calibrated(simulation, **joint):
    """The configuration with the encoder's zero as a calibration finds it."""
    config = configuration(simulation.scenario).model_dump(exclude_unset=True)
    known = {"zero_offset_deg": float(-np.degrees(encoder_zero_rad(simulation))), "zero_offset_sigma_deg": 1e-3}
    config["sensors"]["joint"] |= known | joint
    return Config.model_validate(config)


@lru_cache(maxsize=2)
def _motion(simulation):
    times_s = simulation.delivered["imu"].readings.times_s
    return [simulation.motion.frame(frame, times_s) for frame in ("imu", "base_link")]


def run_simulated(simulation, config=None, names=("base_imu", "joint")):
    """Return the chassis and its errors of the chassis, the estimates being the truth with the gyroscope's noise."""
    cabin, chassis = _motion(simulation)
    imu = simulation.delivered["imu"]
    rates = imu.readings.values["angular_velocity"] - simulation.measured["imu"].values["gyroscope_bias"]
    estimates = []
    for row, stamp in enumerate(imu.stamps_ns.tolist()):
        nav = gtsam.NavState(gtsam.Rot3(cabin.R_W_F[row]), cabin.p_W[row], cabin.v_W[row])
        estimates.append(Estimate.of(stamp, nav, T_W_O, NO_BIAS, NO_COVARIANCE, rates[row], True))
    chassis_run = Chassis(config or calibrated(simulation))
    forces = imu.readings.values["specific_force"].copy()
    states = chassis_run.run(estimates, messages_of(simulation, *names), forces)
    known = [row for row, state in enumerate(states) if state is not None]
    return chassis_run, errors(simulation, imu.readings.times_s, chassis, [(row, states[row]) for row in known])


def errors(simulation, times_s, chassis, states):
    """Compare (row, state) with the true motion of the chassis at the rows."""
    rows = np.array([row for row, _ in states])
    found = [[], [], [], []]
    for row, state in states:
        truth = gtsam.Pose3(gtsam.Rot3(chassis.R_W_F[row]), chassis.p_W[row])
        error = truth.between(state.T_W_B)
        found[0].append(gtsam.Rot3.Logmap(error.rotation()))
        found[1].append(error.translation())
        found[2].append(state.angular_velocity - chassis.angular_velocity[row])
        found[3].append(state.velocity - chassis.R_W_F[row].T @ chassis.v_W[row])
    angle, rate = simulation.motion.joint(times_s[rows])
    angles = np.array([state.joint_angle_rad for _, state in states]) - angle
    columns = [np.array(column) for column in found]
    return Errors(times_s[rows], *columns, angles, np.abs(rate), [state for _, state in states])


def fault(kind, sensor, start_s, end_s, **how):
    return {"kind": kind, "sensors": [sensor], "start_s": start_s, "end_s": end_s, **how}


@lru_cache(maxsize=8)
def simulated(seed=1, faults=(), encoder_offset_s=0.0):
    """The slewing scenario; faults as tuples (kind, sensor, start, end), and an offset that nobody knows."""
    clock = {"offset_s": encoder_offset_s, "calibrated": False}
    return simulate(slewing(*(fault(*given) for given in faults), sensors={"joint": {"clock": clock}}), seed)
