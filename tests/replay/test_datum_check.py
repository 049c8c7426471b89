"""A datum far from every fix is named; one that any fix is near is not."""

import re

import numpy as np
import pytest

from holdfast.config.load import parse_config
from holdfast.messages import FixStatus, GnssFix, ImuSample
from holdfast.replay.datum_check import DatumCheck

CONFIG = """
sensors:
  imu: {{kind: imu, topic: /imu}}
  gnss: {{kind: gnss, topic: /fix}}
extrinsics:
  - {{parent: imu, child: gnss, translation_m: [0, 0, 1]}}
{datum}
initialisation: {{heading_deg: 0}}
"""


def check(latitude_deg=47.4, longitude_deg=8.5):
    datum = f"frames: {{datum: {{latitude_deg: {latitude_deg}, longitude_deg: {longitude_deg}, altitude_m: 450}}}}"
    return DatumCheck(parse_config(CONFIG.format(datum=datum), "test"))


def fix(latitude_deg=47.4, longitude_deg=8.5, status=FixStatus.GBAS):
    return GnssFix(0, 0, "gnss", latitude_deg, longitude_deg, 450.0, np.eye(3) * 1e-4, status)


def test_a_datum_near_the_fixes_is_no_matter():
    near = check()
    assert near.warning is None
    near.add(fix())
    near.add(fix(-33.0, 151.0))
    assert near.warning is None


@pytest.mark.parametrize(("datum", "words"), [
    ((-33.0, 151.0), r"12,255 km or more from it, the nearest at 47.4000, 8.5000; up .* is 147.8 deg off .* another"),
    ((49.4, 8.5), "222 km or more from it, .* is 2.0 deg off there: is it that of another site"),
    ((8.5, 47.4), "km or more from it, .*: are latitude and longitude swapped"),
])  # fmt: skip
def test_a_datum_far_from_every_fix_is_named(datum, words):
    """Estimates were 16,000 km from the origin and metres off, without a word."""
    far = check(*datum)
    far.add(fix())
    assert far.warning is not None and far.warning.startswith("frames.datum: every fix is ")
    assert re.search(words, far.warning)


def test_a_fix_that_comes_near_later_takes_the_warning_back():
    later = check()
    later.add(fix(1.0, 0.0))
    assert later.warning is not None
    later.add(fix())
    assert later.warning is None


def test_only_usable_fixes_count():
    far = check(-33.0, 151.0)
    far.add(fix(status=FixStatus.NO_FIX))
    far.add(fix(latitude_deg=np.nan))
    far.add(ImuSample(0, 0, "imu", np.zeros(3), np.zeros(3)))
    assert far.warning is None


def test_without_a_datum_nothing_is_far():
    without = DatumCheck(parse_config(CONFIG.format(datum=""), "test"))
    without.add(fix())
    assert without.warning is None
