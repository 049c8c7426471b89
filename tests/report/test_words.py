"""Every event, health and outcome has words on the page."""

import pytest

from holdfast.events import EventKind, Health, Outcome
from holdfast.report.words import in_words

GATED = ("innovation", "too_fast", "baseline", "low_status", "no_covariance", "large_covariance", "walking", "late")


@pytest.mark.parametrize("kind", EventKind)
def test_every_kind_of_event_has_words(kind: EventKind):
    words = in_words({"kind": str(kind), "sensor": "gnss", "reason": "some reason"})
    assert "some reason" in words
    routine = kind in (EventKind.REJECTED, EventKind.LATE, EventKind.WAITING)
    assert routine or (not words.startswith(str(kind)) and "_" not in words)


@pytest.mark.parametrize("health", Health)
def test_every_health_has_words(health: Health):
    words = in_words({"kind": "health", "sensor": "", "reason": str(health)})
    assert health is Health.INITIALISING or "_" not in words


@pytest.mark.parametrize("outcome", [o for o in Outcome if o not in ("used", "ignored", "before_start")])
def test_reasons_for_which_a_receiver_is_lost_have_words(outcome: Outcome):
    reason = f"12 {outcome}, 1 innovation; gate power 0.13 m"
    words = in_words({"kind": "receiver_lost", "sensor": "gnss", "reason": reason})
    assert "12 measurements" in words or outcome not in GATED
    assert "1 measurement contradicting the estimate" in words
    assert "any jump beyond 0.13 m" in words
