"""The constants of sensors: one variable as long as it is used, and known beyond that."""

import gtsam
import numpy as np
import pytest

from holdfast.graph.parameters import DOUBTED_NS, MAX_SIZE, REFRESHED_NS, WALK_NS, Parameters, parameter_letter
from holdfast.graph.window import Window
from holdfast.sensors.sensor import Parameter

PRIOR = Parameter(np.array([1.0, -2.0]), np.array([0.5, 0.2]))
SECOND_NS = 1_000_000_000


def empty():
    thresholds = gtsam.ISAM2ThresholdMap()
    for size in range(1, MAX_SIZE + 1):
        thresholds.insert((parameter_letter(size), np.full(size, 1e-3)))
    return Window(thresholds)


def measure(window, key, value, sigma=0.1):
    window.add(gtsam.PriorFactorVector(key, np.array(value), gtsam.noiseModel.Isotropic.Sigma(2, sigma)))


def test_at_first_a_parameter_is_its_prior():
    window, parameters = empty(), Parameters()
    known = parameters.use(window, "wheels", PRIOR, 0)
    assert known.key in window
    np.testing.assert_array_equal(known.value, PRIOR.mean)
    np.testing.assert_allclose(known.covariance, np.diag([0.25, 0.04]))
    found, sigmas = parameters.estimate("wheels")
    np.testing.assert_array_equal(found, PRIOR.mean)
    np.testing.assert_allclose(sigmas, PRIOR.sigmas)
    assert parameters.estimate("laser") is None


def test_a_parameter_is_one_variable_and_each_sensor_has_its_own():
    window, parameters = empty(), Parameters()
    keys = [parameters.use(window, name, PRIOR, 0).key for name in ("wheels", "laser", "wheels")]
    assert keys[0] == keys[2] != keys[1]


def test_once_solved_it_is_what_prior_and_measurements_say():
    window, parameters = empty(), Parameters()
    measure(window, parameters.use(window, "wheels", PRIOR, 0).key, [1.5, -2.0])
    window.solve(0)
    parameters.mark_solved()
    known = parameters.use(window, "wheels", PRIOR, REFRESHED_NS)
    weight = 0.25 / (0.25 + 0.01)
    assert known.value == pytest.approx([1.0 + 0.5 * weight, -2.0])
    np.testing.assert_allclose(np.diag(known.covariance), [0.25 * (1 - weight), 0.04 * 0.01 / 0.05])


def test_its_covariance_is_read_once_a_second_and_its_value_each_time():
    window, parameters = empty(), Parameters()
    measure(window, parameters.use(window, "wheels", PRIOR, 0).key, [1.5, -2.0])
    window.solve(0)
    parameters.mark_solved()
    soon = parameters.use(window, "wheels", PRIOR, REFRESHED_NS - 1)
    assert soon.value[0] > 1.4 and soon.covariance[0, 0] == 0.25
    assert parameters.use(window, "wheels", PRIOR, REFRESHED_NS).covariance[0, 0] < 0.01


def test_a_parameter_stays_as_long_as_it_is_used_and_what_it_knew_is_the_prior_of_the_next():
    window, parameters = empty(), Parameters()
    first = parameters.use(window, "wheels", PRIOR, 0)
    measure(window, first.key, [1.5, -2.0])
    other = parameters.use(window, "laser", PRIOR, 9 * SECOND_NS)
    measure(window, other.key, [1.0, -2.0])
    window.solve(0)
    parameters.mark_solved()
    before = parameters.use(window, "wheels", PRIOR, 2 * SECOND_NS)
    window.solve(2 * SECOND_NS)
    assert before.key == first.key and first.key in window
    window.solve(5 * SECOND_NS)
    assert first.key not in window and other.key in window
    again = parameters.use(window, "wheels", PRIOR, 6 * SECOND_NS)
    assert again.key not in (first.key, other.key)
    np.testing.assert_array_equal(again.value, before.value)
    np.testing.assert_array_equal(again.covariance, before.covariance)


def test_a_copy_goes_its_own_way():
    window, parameters = empty(), Parameters()
    parameters.use(window, "wheels", PRIOR, 0)
    copy = parameters.copy(window, lambda placed: placed)
    copy.use(window, "laser", PRIOR, 0)
    assert parameters.estimate("laser") is None and copy.estimate("wheels") is not None


OFFSET = Parameter(np.zeros(2), np.array([0.03, 0.03]), np.array([0.005, np.inf]))  # the first is right, or far off


def estimated(value, sigma, rounds=2):
    """What becomes of a parameter that is measured, and of one that leaves the window thereafter and comes back."""
    window, parameters = empty(), Parameters()
    measure(window, parameters.use(window, "clock", OFFSET, 0).key, value, sigma)
    for k in range(1, rounds + 1):
        window.solve(0)
        parameters.mark_solved()
        known = parameters.use(window, "clock", OFFSET, k * REFRESHED_NS)
    return window, parameters, known


def test_what_may_be_right_as_configured_is_held_there_while_that_is_more_plausible_than_an_error():
    _, _, known = estimated([0.002, 0.02], 0.003)
    assert abs(known.value[0]) < 0.0003 and known.covariance[0, 0] < 0.001**2
    assert known.value[1] == pytest.approx(0.02, rel=0.02)  # of which nobody said that it may be right


def test_what_is_not_right_is_let_go_but_what_is_hardly_measured_is_not():
    assert estimated([0.02, 0.0], 0.003)[2].value[0] == pytest.approx(0.02, rel=0.02)
    assert estimated([0.02, 0.0], 0.02)[2].is_right


def test_what_was_let_go_is_held_again_when_measurements_agree():
    window, parameters, known = estimated([0.02, 0.0], 0.003)
    assert not known.is_right
    for k in range(3, 40):
        measure(window, known.key, [0.0, 0.0], 0.003)
        window.solve(0)
        parameters.mark_solved()
        known = parameters.use(window, "clock", OFFSET, k * REFRESHED_NS)
        if known.is_right:
            break
    assert known.is_right
    assert abs(known.value[0]) < 0.0005  # as soon as it is held, and not once the solver has seen it
    again = parameters.use(window, "clock", OFFSET, k * REFRESHED_NS)
    assert abs(again.value[0]) < 0.0005


def test_what_was_held_is_let_go_when_measurements_contradict():
    window, parameters, known = estimated([0.002, 0.0], 0.003)
    assert known.is_right
    for k in range(3, 6):
        measure(window, known.key, [0.02, 0.0], 0.001)
        window.solve(0)
        parameters.mark_solved()
        known = parameters.use(window, "clock", OFFSET, k * REFRESHED_NS)
    assert not known.is_right
    window.solve(0)
    assert window.vector(known.key)[0] == pytest.approx(0.0194, abs=0.001)


def test_what_was_held_counts_once_when_it_leaves_the_window_and_comes_back():
    window, parameters, before = estimated([0.002, 0.0], 0.003)
    other = parameters.use(window, "laser", PRIOR, 20 * SECOND_NS)
    measure(window, other.key, [1.0, -2.0])
    window.solve(10 * SECOND_NS)
    again = parameters.use(window, "clock", OFFSET, 21 * SECOND_NS)
    assert again.key != before.key and again.is_right
    np.testing.assert_allclose(again.covariance, before.covariance, rtol=1e-6)


def test_of_one_that_is_off_what_nothing_tells_stays_where_it_was_configured():
    arm = Parameter(np.zeros(3), np.full(3, 2.0), np.full(3, 0.03))
    window, parameters = empty(), Parameters()
    sigmas = np.array([0.05, 0.05, 100.0])
    for k in range(1, 4):
        key = parameters.use(window, "arm", arm, k * REFRESHED_NS).key
        model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        window.add(gtsam.PriorFactorVector(key, np.array([1.0, 0.0, 5.0]), model))
        window.solve(0)
        parameters.mark_solved()
    known = parameters.use(window, "arm", arm, 4 * REFRESHED_NS)
    assert not known.is_right and parameters.constant("arm", arm).is_off
    np.testing.assert_allclose(known.value, [1.0, 0.0, 0.0], atol=0.01)
    assert known.hold is not None and np.sqrt(known.covariance[2, 2]) < 0.001
    model = gtsam.noiseModel.Isotropic.Sigma(3, 0.01)
    window.add(gtsam.PriorFactorVector(known.key, np.array([1.0, 0.0, 0.5]), model))
    for k in range(5, 7):
        window.solve(0)
        parameters.mark_solved()
        known = parameters.use(window, "arm", arm, k * REFRESHED_NS)
    assert known.value[2] == pytest.approx(0.5, abs=0.01)  # once it is told


def test_parameters_of_different_sizes_have_keys_of_different_letters():
    letters = {parameter_letter(size) for size in range(1, MAX_SIZE + 1)}
    assert len(letters) == MAX_SIZE and letters.isdisjoint("xlb")


def test_a_start_is_where_it_is_linearised_first_and_changes_nothing_that_is_known():
    window, parameters = empty(), Parameters()
    known = parameters.use(window, "marker", PRIOR, 0, np.array([1.2, -2.1]))
    np.testing.assert_array_equal(known.value, [1.2, -2.1])
    window.solve(0)
    parameters.mark_solved()
    assert parameters.use(window, "marker", PRIOR, 0, np.array([9.0, 9.0])).value == pytest.approx(PRIOR.mean)


def test_one_that_walks_is_another_variable_in_time_and_less_certain():
    window, parameters = empty(), Parameters()
    walking = PRIOR._replace(walk=np.array([0.01, 0.02]))
    first = parameters.use(window, "imu", walking, 0)
    measure(window, first.key, [1.5, -2.0])
    window.solve(-1)
    parameters.mark_solved()
    before = parameters.use(window, "imu", walking, WALK_NS - 1)
    after = parameters.use(window, "imu", walking, WALK_NS)
    assert before.key == first.key != after.key
    np.testing.assert_array_equal(after.value, before.value)
    window.solve(-1)
    grown = window.covariance(after.key) - window.covariance(before.key)
    np.testing.assert_allclose(grown, np.diag(walking.walk**2) * WALK_NS * 1e-9, atol=1e-9)


def test_what_was_begun_anew_is_not_put_back_to_what_was_configured():
    """As what was learnt yesterday is, once measurements refute it: nothing that was configured is better here."""
    window, parameters, anew = empty(), Parameters(), Parameter(np.array([9.0, 9.0]), np.array([0.5, 0.2]))
    parameters.begin_anew("wheels", anew)
    assert parameters.prior("wheels", PRIOR) is anew
    measure(window, parameters.use(window, "wheels", PRIOR, 0).key, [12.0, 9.0])
    window.solve(0)
    parameters.mark_solved()
    parameters.use(window, "wheels", PRIOR, REFRESHED_NS)
    window.solve(1)
    parameters.mark_solved()
    known = parameters.use(window, "wheels", PRIOR, 2 * REFRESHED_NS)
    assert parameters.prior("wheels", PRIOR) is anew
    weight = 0.25 / (0.25 + 0.01)
    assert known.value == pytest.approx([9.0 + 3.0 * weight, 9.0])


FIRST = Parameter(np.zeros(2), np.full(2, 0.5), np.full(2, 0.01))
SECOND = FIRST._replace(odds=1e4)


def contradicted(between, seconds, doubted=()):
    """What becomes of two of which one is measured against the other, and neither alone; one is asked first."""
    window, parameters, known = empty(), Parameters(), {}
    for k in range(seconds):
        stamp_ns = k * REFRESHED_NS
        if k in doubted:
            parameters.doubt(stamp_ns)
        for name, prior in (("mount", FIRST), ("arm", SECOND)):
            known[name] = parameters.use(window, name, prior, stamp_ns)
        if k == 0:
            keys = known["mount"].key, known["arm"].key
            model = gtsam.noiseModel.Isotropic.Sigma(2, 0.01)
            window.add(gtsam.BetweenFactorVector(*keys, np.array(between), model))
            measure(window, keys[0], [0.0, 0.0], sigma=0.4)
            measure(window, keys[1], [0.0, 0.0], sigma=0.1)
        window.solve(-1)
        parameters.mark_solved()
    return parameters, known


def test_of_those_that_refused_measurements_contradict_the_least_plausible_goes_alone():
    parameters, known = contradicted([0.3, 0.3], 5, doubted=range(5))
    assert not known["mount"].is_right and known["arm"].is_right  # which is measured to be where it is
    assert np.linalg.norm(known["mount"].value + 0.3) < 0.02
    assert parameters.newly_mistaken() == {"mount"}
    assert parameters.newly_mistaken() == frozenset()


def test_what_goes_while_nothing_is_refused_is_no_mistake():
    parameters, known = contradicted([0.3, 0.3], 5)
    assert not known["mount"].is_right and parameters.newly_mistaken() == frozenset()


def test_what_is_held_is_read_more_often_while_measurements_contradict():
    window, parameters = empty(), Parameters()
    measure(window, parameters.use(window, "clock", OFFSET, 0).key, [0.02, 0.0], 0.003)
    window.solve(0)
    parameters.mark_solved()
    assert parameters.use(window, "clock", OFFSET, DOUBTED_NS).is_right
    parameters.doubt(DOUBTED_NS)
    assert not parameters.use(window, "clock", OFFSET, DOUBTED_NS).is_right


def test_what_is_let_go_begins_where_it_is_said_to_be_and_is_held_once_it_proves_right():
    window, parameters = empty(), Parameters()
    measure(window, parameters.use(window, "clock", OFFSET, 0).key, [0.0, 0.0], 0.003)
    window.solve(0)
    parameters.mark_solved()
    parameters.let_go("clock", np.array([0.02, 0.0]))
    known = parameters.use(window, "clock", OFFSET, REFRESHED_NS)
    assert not known.is_right and known.value == pytest.approx([0.02, 0.0])
    assert known.covariance[0, 0] == pytest.approx(0.03**2)
    measure(window, known.key, [0.0, 0.0], 0.003)
    for k in range(2, 4):
        window.solve(0)
        parameters.mark_solved()
        known = parameters.use(window, "clock", OFFSET, k * REFRESHED_NS)
    assert known.is_right
