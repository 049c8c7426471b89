"""The weight of a measurement under a loss that becomes a truncated quadratic one."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from holdfast.smoothing.decisions import SHAPES, refused_runs, weight_of

NIS, SHAPE = st.floats(0.0, 1e6), st.sampled_from(SHAPES)
LIMIT = 16.0


@given(NIS, NIS, SHAPE)
def test_a_larger_residual_never_weighs_more(a, b, shape):
    small, large = sorted((a, b))
    assert 1.0 >= weight_of(small, LIMIT, shape) >= weight_of(large, LIMIT, shape) >= 0.0


@given(SHAPE)
def test_the_weight_is_continuous_where_the_loss_changes_its_form(shape):
    for edge in (shape / (shape + 1.0) * LIMIT, (shape + 1.0) / shape * LIMIT):
        below, above = (weight_of(edge * (1.0 + step), LIMIT, shape) for step in (-1e-9, 1e-9))
        assert abs(below - above) < 1e-3


def test_the_last_loss_truncates_almost_at_the_limit():
    assert weight_of(0.9 * LIMIT, LIMIT, SHAPES[-1]) == 1.0
    assert weight_of(1.1 * LIMIT, LIMIT, SHAPES[-1]) == 0.0


def test_what_cannot_be_compared_weighs_nothing():
    assert weight_of(float("nan"), LIMIT, SHAPES[0]) == 0.0
    assert weight_of(np.inf, LIMIT, SHAPES[0]) == 0.0


def test_a_run_of_refused_measurements_ends_where_one_of_its_sensor_is_believed():
    def one(name, weight):
        return SimpleNamespace(sensor=SimpleNamespace(name=name), weight=weight)

    left, right = [one("left", w) for w in (0.0, 0.1, 1.0, 0.2)], [one("right", w) for w in (0.0, 0.0)]
    runs = refused_runs([left[0], right[0], left[1], left[2], right[1], left[3]], 0.5)
    assert runs == [left[:2], right, left[3:]]
