"""How much a live node says."""

from holdfast.live.line_limit import LINES, PERIOD_NS, LineLimit


def test_of_one_kind_a_few_lines_are_printed_and_the_rest_is_counted():
    limit = LineLimit()
    assert sum(limit.admits(("gnss", "rejected"), k) for k in range(100)) == LINES
    assert limit.admits(("gnss", "late"), 100) and limit.admits(("lidar", "rejected"), 100)
    assert limit.end(PERIOD_NS - 1) == []
    assert limit.end(PERIOD_NS) == [(("gnss", "rejected"), 100 - LINES)]
    assert limit.admits(("gnss", "rejected"), PERIOD_NS + 1)


def test_what_was_said_in_full_is_not_counted_and_forgotten():
    limit = LineLimit()
    assert limit.admits(("", "health"), 0)
    assert limit.end(2 * PERIOD_NS) == [] and limit.end(4 * PERIOD_NS) == []
