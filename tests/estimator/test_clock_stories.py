"""Whatever the clocks do: the work per sample is bounded, answers go on, and the state is right again after 10 s."""

from dataclasses import dataclass, replace
from time import thread_time

import numpy as np
import pytest
from faults import late
from motion import Drive, fixes, imu, in_order, machine, ns, scans, seconds

from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind, Health

DRIVE = Drive()
SIGMA_M = (0.01, 0.01, 0.02)  # of the fixes
RIGHT_M = 3.0 * float(np.linalg.norm(SIGMA_M))
STEP_S, BACK_S, END_S, AGAIN_S = 6.0, 9.0, 20.0, 10.0
HOUR_S, DECADES_S = 3600.0, 50.0 * 365.25 * 86400.0
SIZES_S = {"second": 1.0, "hour": HOUR_S, "50 years": DECADES_S}
CALL_S, SILENT_S = 0.05, 0.05
ALL = ("imu", "gnss", "lidar")


def begin_to(begin_s, end_s, sensors, clock):
    """A stretch of true time in which the clock of sensors shows `clock(t)` [s]."""
    return lambda sensor, t: clock(t) if begin_s <= t < end_s and sensor in sensors else t


def step(by_s, at_s=STEP_S, sensors=ALL, end_s=np.inf):
    """The clock of sensors is off by a constant from a time until another."""
    return begin_to(at_s, end_s, sensors, lambda t: t + by_s)


@dataclass(frozen=True)
class Story:
    """What clocks show at a true time, one after another; when the last thing happens; what is not delivered.

    `events` are reasons that must be told, `silent_s` is for how long the answers may stop. A start takes its time
    until `begun_s`.
    """

    clocks: tuple
    last_s: float = STEP_S
    outages: tuple = ()  # sensor, begin, end
    events: tuple = ()
    silent_s: float = SILENT_S
    arrivals_step: bool = False
    begun_s: float = 4.0


def recorded(end_s=END_S, seed=3):
    """All sensors of a drive, each with delays of its own."""
    rng = np.random.default_rng(seed)

    def delayed(messages, delay_s, jitter_s):
        return late(messages, delay_s + rng.uniform(0.0, jitter_s, len(messages)))

    return in_order(
        delayed(imu(DRIVE, 0.0, end_s, 100.0, rng), 0.002, 0.002),
        delayed(fixes(DRIVE, 0.0, end_s, 5.0, rng, SIGMA_M, phase_s=0.0137), 0.05, 0.03),
        delayed(scans(DRIVE, 0.0, end_s, 2.5, rng, phase_s=0.0071), 0.08, 0.03),
    )


def told(story, message):
    """The message as its sensor stamps it."""
    t = seconds(message.stamp_ns)
    for clock in story.clocks:
        t = clock(message.sensor, t)
    stamp_ns = ns(t)
    arrival_ns = message.arrival_ns + (stamp_ns - message.stamp_ns if story.arrivals_step else 0)
    return replace(message, stamp_ns=stamp_ns, arrival_ns=arrival_ns)


def is_delivered(story, message):
    t = seconds(message.stamp_ns)
    return not any(message.sensor == sensor and begin <= t < end for sensor, begin, end in story.outages)


def lived(estimator, story, messages=None):
    """True times of the answers, errors [m], how far their stamps are from those of their samples; each call [s]."""
    answers, calls_s = [], []
    for message in messages or recorded():
        if not is_delivered(story, message):
            continue
        shown = told(story, message)
        began_s = thread_time()  # of this thread: other programs do not count
        output = estimator.process(shown)
        took_s = thread_time() - began_s
        t = seconds(message.stamp_ns)
        if message.sensor == "imu" and t > story.begun_s:
            calls_s.append(took_s)
        if output.estimate is not None:
            error_m = float(np.linalg.norm(output.estimate.nav.position() - DRIVE.nav(t).position()))
            answers.append((t, error_m, (output.estimate.stamp_ns - shown.stamp_ns) * 1e-9))
    return np.array(answers), np.array(calls_s)


def judge(story, estimator, answers, calls_s):
    t, error_m, off_s = answers.T
    if calls_s.max() > CALL_S:  # this machine, or the work? the estimator is deterministic, so work lasts again
        calls_s = np.minimum(calls_s, lived(Estimator(machine()), story)[1])
    assert calls_s.max() < CALL_S
    assert np.diff(t).max() <= story.silent_s + 1e-6
    assert t[-1] > END_S - 0.02
    assert error_m[t > story.last_s + AGAIN_S].max() < RIGHT_M
    assert abs(off_s[t > story.last_s + AGAIN_S]).max() < 0.01
    assert estimator.health is Health.NOMINAL
    steps = [event.reason for event in estimator.events if event.kind is EventKind.CLOCK_STEP]
    for reason in story.events:
        assert any(reason in step for step in steps), steps
    assert len(steps) <= 8  # not one for each message


SLOW = pytest.mark.slow
STORIES = {}
for size, by_s in SIZES_S.items():
    for way, sign in (("ahead", 1.0), ("back", -1.0)):
        name, d = f"{size} {way}", sign * by_s
        STORIES[f"all sensors {name}"] = Story((step(d),), events=(f"stepped {way} by {by_s:.2f} s",))
        STORIES[f"the IMU {name}"] = Story((step(d, sensors=("imu",)),), events=(f"stepped {way} by {by_s:.2f} s",))
        STORIES[f"GNSS {name} and again right"] = Story(
            (step(d, sensors=("gnss",), end_s=BACK_S),), BACK_S, events=() if d == -1.0 else ("refused", "again")
        )
        if d != -1.0:  # which may be late as well
            of_gnss = step(d, sensors=("gnss",))
            STORIES[f"GNSS {name} for good"] = Story((of_gnss,), STEP_S + 2.0, events=("read by a clock",))
            STORIES[f"GNSS and lidar {name} from the start"] = Story(
                (step(d, -1.0, ("gnss", "lidar")),), 3.0, events=("read by a clock",), begun_s=3.0 + AGAIN_S
            )
        STORIES[f"in an outage {name}"] = Story((step(d),), BACK_S, outages=(("gnss", 5.0, BACK_S),))
STORIES |= {
    "all at the start": Story((step(DECADES_S, 0.5),)),
    "all back at the start": Story((step(-DECADES_S, 0.5),)),
    "the first sample of the IMU is of 2100": Story((step(DECADES_S, -1.0, ("imu",), 0.005),)),
    "an hour ahead and back": Story((step(HOUR_S, end_s=BACK_S),), BACK_S),
    "a second ahead and back": Story((step(1.0, end_s=BACK_S),), BACK_S),
    "a second back, twice": Story((step(-1.0), step(-1.0, BACK_S)), BACK_S),
    "1970 to 2020, corrected by a second": Story((step(DECADES_S), step(-1.0, BACK_S)), BACK_S),
    "GNSS steps two seconds after the others": Story(
        (step(HOUR_S, sensors=("imu", "lidar")), step(HOUR_S, 8.0, ("gnss",))), 8.0
    ),
    "GNSS steps two seconds before the others": Story(
        (step(HOUR_S, sensors=("gnss",)), step(HOUR_S, 8.0, ("imu", "lidar"))), 8.0
    ),
    "the lidar is an hour ahead for a while": Story((step(HOUR_S, sensors=("lidar",), end_s=BACK_S),), BACK_S),
    "the lidar steps ahead by a tenth of a second": Story((step(0.1, sensors=("lidar",)),)),
    "the lidar steps back by a tenth of a second": Story((step(-0.1, sensors=("lidar",)),)),
    "a leap second is inserted": Story((begin_to(STEP_S, np.inf, ALL, lambda t: t - 1.0),)),
    "a leap second is smeared": Story(
        (
            begin_to(4.0, BACK_S, ALL, lambda t: t + 0.01 * (t - 4.0)),
            step(0.05, BACK_S),
        ),
        BACK_S,
    ),
    "100 ppm of drift": Story((begin_to(0.0, np.inf, ALL, lambda t: t * (1.0 + 1e-4)),), 0.0),
    "100 ppm of drift of the IMU": Story((begin_to(0.0, np.inf, ("imu",), lambda t: t * (1.0 + 1e-4)),), 0.0),
    "the stamps of the IMU stick": Story((begin_to(STEP_S, BACK_S, ("imu",), lambda _: STEP_S),), BACK_S),
    "all stamps stick": Story((begin_to(STEP_S, BACK_S, ALL, lambda _: STEP_S),), BACK_S),
    "the IMU sticks and goes on from there": Story(
        (begin_to(STEP_S, BACK_S, ("imu",), lambda _: STEP_S), step(-3.0, BACK_S, ("imu",))), BACK_S
    ),
    "the stamps of the IMU are zero for a while": Story((begin_to(STEP_S, BACK_S, ("imu",), lambda _: 0.0),), BACK_S),
    "a counter of 32 bits wraps": Story((step(-(2.0**32) * 1e-9),), events=("stepped back by 4.",)),
    "arrivals step along ahead": Story((step(HOUR_S),), silent_s=9.0, arrivals_step=True, events=("starting over",)),
    "arrivals step along back": Story((step(-HOUR_S),), silent_s=9.0, arrivals_step=True, events=("starting over",)),
}
QUICK = {"all sensors 50 years ahead", "all sensors second back", "GNSS hour ahead and again right", "all at the start"}
QUICK |= {"in an outage hour back", "an hour ahead and back", "arrivals step along ahead", "all stamps stick"}


def test_a_silence_of_everything_is_crossed_or_begun_anew_after_but_never_computed_for_long():
    """An hour used to take 7.6 s of one sample; a fix after it made a node for every half second."""
    for silence_s, reason in ((8.0, None), (HOUR_S, "starting over")):
        estimator = Estimator(machine())
        lived(estimator, Story(()), [m for m in recorded() if seconds(m.stamp_ns) < STEP_S])
        after = [replace(m, stamp_ns=m.stamp_ns + ns(silence_s) - ns(0.0)) for m in recorded()]
        after = [replace(m, arrival_ns=m.arrival_ns + ns(silence_s) - ns(0.0)) for m in after]
        after = [m for m in after if seconds(m.stamp_ns) - silence_s >= STEP_S]
        first = [m for m in after if m.sensor == "gnss"][:30]  # GNSS is back before the IMU
        calls_s, outputs = [], []
        for message in [*first, *(m for m in after if m.arrival_ns > first[-1].arrival_ns)]:
            began_s = thread_time()
            outputs.append(estimator.process(message))
            calls_s.append(thread_time() - began_s)
        assert sorted(calls_s)[-3] < CALL_S  # two for the machine
        steps = [event.reason for event in estimator.take_events() if event.kind is EventKind.CLOCK_STEP]
        assert (reason is None and not steps) or any(reason in step for step in steps)
        last = [output.estimate for output in outputs if output.estimate is not None][-1]
        truth = DRIVE.nav(seconds(last.stamp_ns) - silence_s)
        assert seconds(last.stamp_ns) - silence_s > END_S - 0.02
        assert np.linalg.norm(last.nav.position() - truth.position()) < RIGHT_M


@pytest.mark.parametrize(
    "story", [pytest.param(one, id=name, marks=() if name in QUICK else SLOW) for name, one in STORIES.items()]
)
def test_the_answer_is_right_again_and_never_late(story):
    estimator = Estimator(machine())
    judge(story, estimator, *lived(estimator, story))
