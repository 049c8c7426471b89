"""Estimates the drive that ships with gtsam, causally and as a whole, and prints what fixes say that it never saw.

`python examples/api_example.py [SECONDS]`; uses the public API only, and passes `mypy --strict`.
"""

# ruff: noqa: T201
import sys

import holdfast

CONFIG = {
    "sensors": {
        "imu": {"kind": "imu", "topic": "/imu"},
        "gnss": {"kind": "gnss", "topic": "/gnss/fix", "frame": "imu", "time_offset_s": 0.059},
    }
}


def main(duration_s: float | None = None) -> None:
    """Smooth the drive and compare the two estimates."""
    result = holdfast.smooth("kitti", CONFIG, hold_out={"gnss": 2}, duration_s=duration_s)
    causal, optimum = result.world, result.smoothed
    assert optimum is not None
    apart = causal.errors(optimum)
    print(f"{len(causal)} states over {causal.times_s[-1]:.0f} s, {len(result.events)} events")
    print(f"causal and optimum are {apart['translation_m'].max():.2f} m apart at most")
    print(f"sigma of the optimum: {optimum.sigmas_m().mean():.3f} m per axis in the mean")
    for track in ("causal", "batch"):
        errors = result.summary["held_out"][track]["all"]["horizontal_m"]
        print(f"{track:6s} against {errors['count']} fixes that it never saw: RMS {errors['rms']:.3f} m")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else None)
