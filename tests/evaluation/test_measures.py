from math import inf, nan

import pytest

from holdfast.evaluation.measures import MEASURES, Measure

ERROR = Measure("e_m", "error", "mm", 1e3, most=10.0)
NEES = Measure("n", "NEES", "1", digits=2, least=0.7, most=1.5)
TIME = Measure("t_s", "time", "s", digits=2, most=5.0, only=("liar",))


def test_every_measure_has_a_key_and_a_label_of_its_own():
    assert len({measure.key for measure in MEASURES}) == len({measure.label for measure in MEASURES}) == len(MEASURES)


def test_scores_are_shown_in_the_unit_of_the_measure():
    assert ERROR.text(0.01234) == "12.3"
    assert (ERROR.text(nan), TIME.text(inf), NEES.text(inf)) == ("-", "never", "inf")


def test_a_target_is_said_in_words():
    assert (ERROR.target, NEES.target, TIME.target) == ("<= 10", "0.7 to 1.5", "<= 5 (liar)")


@pytest.mark.parametrize(
    ("measure", "score", "reached"),
    [
        (ERROR, 0.01, True),
        (ERROR, 0.0101, False),
        (ERROR, inf, False),
        (NEES, 0.69, False),
        (NEES, 1.0, True),
        (NEES, 1.51, False),
        (TIME, 6.0, True),
    ],
)
def test_a_score_reaches_its_target_or_does_not(measure, score, reached):
    assert measure.is_reached(score, "tunnel") == reached


def test_a_target_of_one_scenario_counts_there():
    assert not TIME.is_reached(6.0, "liar")
    assert TIME.is_reached(nan, "liar")


def test_mean_and_worst_leave_out_runs_without_an_occasion():
    assert ERROR.mean([0.01, nan, 0.03]) == pytest.approx(0.02)
    assert ERROR.worst([0.01, nan, 0.03]) == 0.03
    assert ERROR.text(ERROR.worst([nan])) == ERROR.text(ERROR.mean([])) == "-"


def test_the_worst_ratio_is_that_farthest_from_one():
    assert NEES.worst([0.4, 1.0, 2.0]) == 0.4
    assert NEES.worst([0.6, 1.0, 2.0]) == 2.0
    assert NEES.worst([0.1, inf]) == inf
