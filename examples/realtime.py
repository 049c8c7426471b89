"""A machine that runs: one call per message, an answer at every sample of the IMU, the optimiser in another process.

    holdfast simulate quick -o quick && python examples/realtime.py quick

Here the messages come from a recording at their own pace; on a machine they come from your drivers.
"""

# ruff: noqa: T201
import sys
import time

import holdfast
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions

folder = sys.argv[1]
config = holdfast.load_config(f"{folder}/config.yaml")
with holdfast.RealtimeEstimator(config) as estimator, open_recording(folder) as recording:
    estimator.wait_until_ready()
    ahead_ns, said_ns = None, 0
    for message in recording.read(subscriptions(config)):
        ahead_ns = ahead_ns or message.arrival_ns - time.monotonic_ns()
        time.sleep(max(0.0, (message.arrival_ns - ahead_ns - time.monotonic_ns()) * 1e-9))
        output = estimator.process(message)  # or add_imu(...), add_gnss(...), add_lidar(...), ...
        for event in estimator.take_events():
            print(event.kind, event.sensor, event.reason)
        if output.estimate is not None and output.estimate.stamp_ns > said_ns + 1_000_000_000:
            said_ns = output.estimate.stamp_ns
            east, north, up = output.estimate.nav.position()
            sigma = output.estimate.covariance[3:6, 3:6].trace() ** 0.5
            print(f"{east:8.3f} {north:8.3f} {up:8.3f} m +- {sigma:.3f} m, {estimator.health}")
