"""Clearance of the hull: a bound on distances along curves that are known in closed form."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.corridor import Hull, Obstacles
from jaxscp.verification.clearance import clearance
from jaxscp.verification.rollout import Rollout

RADIUS, REACH = 0.25, 50.0
CONSERVATIVE = 1e-3  # m: (h / 4) V with 50 chords an interval, on the curves below
MEASURE = jax.jit(clearance)


def hull(points, present=None, deck=None, at_deck=(False, False), spread=0.0, reach=REACH):
    points = jnp.asarray(points, float)
    masks = [
        jnp.full(len(points), default) if mask is None else jnp.asarray(mask)
        for mask, default in ((present, True), (deck, False))
    ]
    return Hull(
        jnp.array(RADIUS),
        Obstacles(points, *masks, jnp.array(spread), jnp.array(reach)),
        jnp.asarray(at_deck),
    )


def flown(position, velocity, end=2.0, samples=200):
    """A rollout of two intervals along a curve."""
    edges = np.linspace(0.0, end, 3)
    time = np.stack([np.linspace(a, b, samples) for a, b in pairwise(edges)])
    state = np.zeros((2, samples, 13))
    state[..., :3], state[..., 3:6] = position(time), velocity(time)
    return Rollout(*map(jnp.asarray, (time, state, np.zeros((2, samples, 4)))))


def circle(radius=2.0, rate=1.5):
    """Position and velocity on a circle about the origin."""

    def position(t):
        return np.stack([radius * np.cos(rate * t), radius * np.sin(rate * t), 0.0 * t], axis=-1)

    def velocity(t):
        return radius * rate * np.stack([-np.sin(rate * t), np.cos(rate * t), 0.0 * t], axis=-1)

    return position, velocity


@pytest.mark.parametrize("samples", [20, 57, 200, 201])
def test_the_distance_to_a_circle_holds_between_the_samples(samples):
    """Points on rays at the middle of samples, where the path is farthest from its chords."""
    angles = np.linspace(0.1, 2.9, 64) + 0.5 * 1.5 / (samples - 1)
    outer = np.stack([2.9 * np.cos(angles), 2.9 * np.sin(angles), 0.0 * angles], axis=1)
    found = float(MEASURE(hull(outer), flown(*circle(), samples=samples)))
    chord = 0.25 * (1.0 / min(samples - 1, 50)) ** 2 * 2.0 * 1.5**2 * 2.0  # (h / 4) V, twice
    assert 0.9 - RADIUS - chord <= found <= 0.9 - RADIUS + 1e-12


def test_the_bound_gives_little_away_with_the_certificates_samples():
    found = float(MEASURE(hull([[2.0 * np.cos(1.2), 2.0 * np.sin(1.2), 1.0]]), flown(*circle())))
    assert 1.0 - RADIUS - CONSERVATIVE <= found <= 1.0 - RADIUS


def test_a_point_between_two_samples_of_a_straight_path_is_found():
    line = (
        (lambda t: np.stack([t, 0.0 * t, 0.0 * t], axis=-1)),
        (lambda t: np.full((*t.shape, 3), [1.0, 0, 0])),
    )
    middle = 0.5 / 19.0
    assert float(MEASURE(hull([[middle, 0.0, 0.0]]), flown(*line, samples=20))) == pytest.approx(
        -RADIUS, abs=1e-9
    )


def test_rows_that_pad_do_not_count_and_nothing_beyond_the_reach_is_known():
    near_row_pads = hull([[2.0, 0.0, 0.0], [2.0, 0.0, 9.0]], present=[False, True])
    assert float(MEASURE(near_row_pads, flown(*circle()))) == pytest.approx(9.0 - RADIUS, abs=CONSERVATIVE)
    none = hull([[2.0, 0.0, 0.0]], present=[False], reach=0.4)
    assert float(MEASURE(none, flown(*circle()))) == pytest.approx(0.4 - RADIUS)


def test_points_of_a_deck_count_except_in_the_legs_from_and_to_it():
    """The point lies on the first half of the path, 4 sin(0.75) m from the start of the second half."""
    deck = {"points": [[2.0, 0.0, 0.0]], "deck": [True]}
    path = flown(*circle())
    assert float(MEASURE(hull(**deck), path)) == pytest.approx(-RADIUS, abs=CONSERVATIVE)
    elsewhere = float(MEASURE(hull(**deck, at_deck=(True, False)), path))
    assert elsewhere == pytest.approx(4.0 * np.sin(0.75) - RADIUS, abs=CONSERVATIVE)
    assert float(MEASURE(hull(**deck, at_deck=(True, True)), path)) == pytest.approx(REACH - RADIUS)


def test_the_spread_of_a_thinned_cloud_is_taken_off():
    exact, thinned = (float(MEASURE(hull([[5.0, 0.0, 0.0]], spread=s), flown(*circle()))) for s in (0.0, 0.1))
    assert exact - thinned == pytest.approx(0.1)


def test_a_path_that_is_no_number_touches():
    lost = flown(*circle())
    lost = Rollout(lost.time, lost.state.at[1, 50:].set(jnp.nan), lost.control)
    assert float(MEASURE(hull([[9.0, 0.0, 0.0]]), lost)) == -np.inf
