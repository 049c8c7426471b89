"""The paper's comparison systems behind the estimator's interface: a message in, an output out.

`msf.make_msf`, `tsif.make_tsif` and `odometry_alone.make_odometry_alone`; docs/baselines.md says how they were built
and tuned.
"""
