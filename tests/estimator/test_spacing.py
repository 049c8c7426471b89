"""How far apart in time measurements come."""

import pytest
from motion import ns

from holdfast.estimator.spacing import Spacing


@pytest.mark.parametrize(
    ("stamps_s", "spacing_s"),
    [
        ((), 0.0),
        ((5.0,), 0.0),
        ((5.0, 15.0), 0.0),
        ((5.0, 15.0, 25.0), 10.0),
        ((5.0, 5.1, 65.0), 0.1),  # a silence
        ((5.0, 65.0, 65.1), 0.1),
        ((5.0, 15.0, 14.9, 25.0), 10.0),  # one that is late
    ],
)
def test_the_newest_three_tell(stamps_s, spacing_s):
    spacing = Spacing()
    for stamp_s in stamps_s:
        spacing.add(ns(stamp_s))
    assert spacing.spacing_ns == pytest.approx(ns(spacing_s), abs=ns(1e-6))
