"""The paper's comparison systems behind the estimator's interface: a message in, an output out.

`msf.make_msf`, `tsif.make_tsif` and `lidar_alone.LidarAlone`; docs/baselines.md says how they were built and tuned.
"""
