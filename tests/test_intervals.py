"""Intervals hold the truth as often as they say, and nothing measured is never a number."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxgrasp.study.intervals import Estimate, difference, mean, share

# Binomial and mean coverage swings round 95 %; a sound interval stays above this for each case.
LEAST = 0.93
ROUNDS = 3000


def coverage(estimates, truth):
    return np.mean([e.low - 1e-12 <= truth <= e.high + 1e-12 for e in estimates])


def scores(rng, red, green, size):
    """Scores as the thesis's function gives them: piles at 0 and 1, squares of shares between."""
    u = rng.random(size)
    return np.where(u < red, 0.0, np.where(u < 1 - green, rng.random(size) ** 2, 1.0))


def true_mean(red, green):
    return green + (1 - red - green) / 3


def test_a_share_is_wilsons_by_his_own_equation():
    # The ends solve |p - x| = z sqrt(x (1 - x) / n): independent of the closed formula.
    e = share(37, 120)
    for end in (e.low, e.high):
        z = abs(37 / 120 - end) / math.sqrt(end * (1 - end) / 120)
        assert z == pytest.approx(1.959964, abs=1e-5)
    assert (e.value, e.count) == (37 / 120, 120)
    assert (share(95, 100).low, share(95, 100).high) == pytest.approx((0.8882, 0.9785), abs=1e-4)


def test_shares_of_none_and_all_reach_the_bound_but_do_not_shrink_to_it():
    none, all_ = share(0, 16), share(16, 16)
    assert none.low == 0 and none.high == pytest.approx(0.1936, abs=1e-3)
    assert all_.high == 1 and all_.low == pytest.approx(1 - none.high)


@pytest.mark.parametrize("n", [16, 120, 2000])
@pytest.mark.parametrize("p", [0.5, 0.86, 0.99])
def test_shares_hold_the_truth(n, p):
    hits = np.random.default_rng(1).binomial(n, p, ROUNDS)
    found = coverage([share(int(h), n) for h in hits], p)
    # Counts are whole: of 16, Wilson's exact coverage is 92.3 % at 0.5 and 85.1 % at 0.99.
    exact = {(16, 0.5): 0.9232, (16, 0.99): 0.8515}.get((n, p), 0.945)
    assert found >= exact - 0.015


@pytest.mark.parametrize("n", [10, 16, 42, 120, 2000])
@pytest.mark.parametrize(("red", "green"), [(0.1, 0.65), (0.6, 0.2), (0.005, 0.95), (0.05, 0.95)])
def test_means_of_scores_hold_the_truth(n, red, green):
    rng = np.random.default_rng(n)
    found = coverage(
        [mean(row) for row in scores(rng, red, green, (ROUNDS, n))], true_mean(red, green)
    )
    assert found >= LEAST


@pytest.mark.parametrize("n", [16, 120, 2000])
def test_paired_differences_hold_the_truth_and_are_narrower_than_apart(n):
    rng = np.random.default_rng(n)
    shared = scores(rng, 0.1, 0.6, (ROUNDS, n))
    changed = rng.random((ROUNDS, n)) < 0.12
    other = np.where(changed, scores(rng, 0.3, 0.5, (ROUNDS, n)), shared)
    truth = 0.12 * (true_mean(0.1, 0.6) - true_mean(0.3, 0.5))
    found = [difference(a, b) for a, b in zip(shared, other, strict=True)]
    assert coverage(found, truth) >= LEAST
    if n >= 120:
        apart = mean(shared[0]).high - mean(shared[0]).low
        assert found[0].high - found[0].low < apart


def test_an_interval_of_more_values_is_narrower():
    rng = np.random.default_rng(0)
    widths = [(e := mean(scores(rng, 0.1, 0.6, n))).high - e.low for n in (10, 100, 1000, 10000)]
    assert all(wide > 2.5 * narrow for wide, narrow in zip(widths, widths[1:], strict=False))


def test_of_nothing_there_is_no_figure():
    nothing = Estimate(None, None, None, 0)
    assert share(0, 0) == mean([]) == mean([math.nan]) == difference([], []) == nothing
    assert nothing.holds(0.0) is None


def test_a_missing_value_is_left_out_and_the_count_says_so():
    assert mean([0.5, math.nan, 1.0]) == mean([0.5, 1.0])
    assert mean([0.5, math.nan, 1.0]).count == 2
    assert difference([1.0, math.nan, 0.0], [0.5, 1.0, math.nan]).count == 1


@given(st.lists(st.floats(0, 1), min_size=1, max_size=60))
def test_the_value_lies_in_its_interval_and_the_interval_in_the_bounds(values):
    e = mean(values)
    assert e.value == pytest.approx(np.mean(values))
    assert 0 <= e.low <= e.value <= e.high <= 1
    d = difference(values, values[::-1])
    assert -1 <= d.low <= d.value <= d.high <= 1
    assert e.holds(e.value) and not e.holds(1.5)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=40))
def test_scaled_values_have_a_scaled_interval(values):
    one, half = mean(values), mean(np.array(values) / 2, bounds=(0.0, 0.5))
    assert [half.value, half.low, half.high] == pytest.approx(
        [one.value / 2, one.low / 2, one.high / 2]
    )


def test_values_outside_the_bounds_and_unequal_pairs_are_refused():
    with pytest.raises(ValueError, match="a value is 1.5; valid: 0.0 to 1.0"):
        mean([0.5, 1.5])
    with pytest.raises(ValueError, match="a value is -0.5"):
        difference([0.5], [-0.5])
    with pytest.raises(ValueError, match="pairs have 1 and 2 values"):
        difference([0.5], [0.5, 0.5])
    with pytest.raises(ValueError, match="share is 3 of 2"):
        share(3, 2)
