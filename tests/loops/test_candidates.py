"""Candidates are near by the estimate, apart in time, and worth a registration."""

import numpy as np

from holdfast.loops.candidates import APART_S, MAX_PAIRS, candidates, keyframes_of

ROUND_S = 40  # for one round on a circle of 10 m


def rounds(number, sigma_m=0.1, hz=2.0, turned=0.0):
    times_s = np.arange(0.0, number * ROUND_S, 1.0 / hz)
    angle = 2.0 * np.pi * times_s / ROUND_S
    positions = 10.0 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    yaw = angle + turned * (times_s >= ROUND_S)
    attitudes = np.column_stack([np.zeros((len(yaw), 2)), np.sin(yaw / 2.0), np.cos(yaw / 2.0)])
    covariances = np.tile(np.diag(np.repeat([0.01, sigma_m, 0.1], 3) ** 2), (len(yaw), 1, 1))
    return keyframes_of((times_s * 1e9).astype(np.int64), positions, attitudes, covariances)


def test_a_second_round_finds_the_first_one():
    pairs = candidates(rounds(2), -1)
    assert len(pairs) >= 10
    assert all(pair.later.time_ns - pair.earlier.time_ns >= APART_S * 1e9 for pair in pairs)
    assert max(np.linalg.norm(pair.earlier.position - pair.later.position) for pair in pairs) < 7.0


def test_one_round_closes_only_where_it_ends():
    assert len(candidates(rounds(1), -1)) < 5


def test_where_the_estimate_is_known_well_nothing_is_to_be_gained():
    assert candidates(rounds(2, sigma_m=0.005), -1) == []


def test_a_machine_that_looks_the_other_way_is_no_candidate():
    pairs = candidates(rounds(2, turned=np.pi), -1)
    assert all(np.linalg.norm(pair.earlier.position - pair.later.position) > 3.0 for pair in pairs)


def test_only_what_ends_after_a_time_is_found_and_never_more_than_a_bound():
    keyframes = rounds(20)
    pairs = candidates(keyframes, keyframes[len(keyframes) // 2].time_ns)
    assert 0 < len(pairs) <= MAX_PAIRS
    assert all(pair.later.time_ns > keyframes[len(keyframes) // 2].time_ns for pair in pairs)
