"""More starts: from a slower guess, and on a bounded mesh."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.core.status import Status
from jaxscp.scp import mesh
from jaxscp.scp.restart import STARTS, restarted, slower
from jaxscp.transcription.layout import trajectory_of
from jaxscp.transcription.shooting import Grid
from tests.support.flights import random_nodes, short_problem

PROBLEM = short_problem()
GUESS = random_nodes(PROBLEM, 0)
SLOWER = STARTS[1][0]
COARSE, FINE = Grid(5), Grid(5, 12)


class End(eqx.Module):
    """Last state: the guess, and whether it was slow enough."""

    z: Any
    status: Any


class Threshold(eqx.Module):
    """The simplest method: it converges from guesses that take a time at least, and takes no step."""

    least: Any
    grid: Any = None

    def on_the_way(self, state):
        """It takes no step."""
        return False

    def run(self, problem, z, enabled, keep_mesh):
        """The end."""
        enough = jnp.sum(trajectory_of(problem, z).dilation) >= self.least
        return End(z, Status.where(enough & enabled, Status.converged, Status.dynamics_unmet))


class BoundedMesh(eqx.Module):
    """Converges where no node's dilation may exceed a limit, and takes no step."""

    limit: Any
    grid: Any

    def on_the_way(self, state):
        """It takes no step."""
        return False

    def run(self, problem, z, enabled, keep_mesh):
        """The end."""
        short = jnp.all(problem.dilation_max <= self.limit)
        return End(z, Status.where(short & enabled, Status.converged, Status.dynamics_unmet))


class LongWay(eqx.Module):
    """Goes one unit in the first variable at a time, to a solution that is two units away."""

    known: bool = eqx.field(static=True)
    """Whether it knows that it is on its way."""
    grid: Any = None

    def on_the_way(self, state):
        """As long as it has not arrived."""
        return self.known & (state.status != Status.converged)

    def run(self, problem, z, enabled, keep_mesh):
        """The end."""
        z = z.at[0, 0].add(1.0)
        arrived = z[0, 0] >= GUESS[0, 0] + 1.5
        return End(z, Status.where(arrived & enabled, Status.converged, Status.dynamics_unmet))


def total(z):
    return float(jnp.sum(trajectory_of(PROBLEM, z).dilation))


def end(factor, enabled=True):
    """The end of a method that needs a factor of the guess's time."""
    return restarted(
        Threshold(factor * total(GUESS)), PROBLEM, GUESS, jnp.asarray(enabled), jnp.array(False)
    )[0]


def test_the_slower_guess_is_the_same_path_in_more_time():
    before, after = (trajectory_of(PROBLEM, z) for z in (GUESS, slower(PROBLEM, GUESS, SLOWER)))
    np.testing.assert_array_equal(after.state, before.state)
    np.testing.assert_array_equal(after.control, before.control)
    most = np.maximum(float(PROBLEM.dilation_max), before.dilation)
    np.testing.assert_allclose(after.dilation, np.minimum(SLOWER * before.dilation, most))


def test_it_starts_again_only_where_that_helps():
    assert Status.converged == end(0.9).status
    np.testing.assert_array_equal(end(0.9).z, GUESS)
    np.testing.assert_array_equal(end(1.1).z, slower(PROBLEM, GUESS, SLOWER))
    np.testing.assert_array_equal(end(9.0).z, GUESS)  # neither converges: the end is the first one's
    np.testing.assert_array_equal(end(1.1, enabled=False).z, GUESS)


def test_elements_of_a_batch_start_again_by_themselves():
    """The first is slow enough, the second is after its restart, the third is not."""
    guesses = jnp.stack([slower(PROBLEM, GUESS, SLOWER), GUESS, jnp.asarray(GUESS).at[:, -1].multiply(0.5)])
    method = Threshold(1.1 * total(GUESS))
    found, _ = jax.vmap(lambda z: restarted(method, PROBLEM, z, jnp.array(True), jnp.array(False)))(guesses)
    for z, expected in zip(found.z, (guesses[0], guesses[0], guesses[2]), strict=True):
        np.testing.assert_array_equal(z, expected)


def test_the_last_starts_bound_the_mesh():
    """The first of them is slower, and the bounds come with the end."""
    time, ratio = STARTS[2]
    limit = ratio * float(jnp.mean(GUESS[:, -1]))
    state, most = restarted(
        BoundedMesh(limit * 1.001, FINE), PROBLEM, GUESS, jnp.array(True), jnp.array(False)
    )
    assert Status.converged == state.status
    np.testing.assert_array_equal(state.z, slower(PROBLEM, GUESS, time))
    np.testing.assert_allclose(most, limit)
    without, _ = restarted(
        BoundedMesh(limit * 1.001, None), PROBLEM, GUESS, jnp.array(True), jnp.array(False)
    )
    assert Status.dynamics_unmet == without.status


def test_a_coarse_solution_is_the_next_guess_on_a_shorter_mesh():
    """A quick turn in long intervals: each start shortens them, until they are accurate."""
    turning = GUESS.at[3, -1].set(6.0)
    assert np.isfinite(mesh.bounds(PROBLEM, turning, COARSE)).any()
    state, most = restarted(Threshold(0.0, COARSE), PROBLEM, turning, jnp.array(True), jnp.array(False))
    assert Status.converged == state.status
    assert np.all(np.isinf(mesh.bounds(PROBLEM, state.z, COARSE)))
    np.testing.assert_array_equal(state.z[:, :-1], turning[:, :-1])
    np.testing.assert_array_equal(state.z[:, -1], np.minimum(turning[:, -1], most))
    assert np.isinf(most).any(), "accurate intervals are free"


def test_where_no_start_converges_it_goes_on_from_the_first_ones_end():
    state, _ = restarted(LongWay(known=True), PROBLEM, GUESS, jnp.array(True), jnp.array(False))
    assert state.status == Status.converged
    np.testing.assert_array_equal(state.z[0, 0], GUESS[0, 0] + 1.0 + 1.0)
    state, _ = restarted(LongWay(known=False), PROBLEM, GUESS, jnp.array(True), jnp.array(False))
    assert state.status == Status.dynamics_unmet
    np.testing.assert_array_equal(state.z[0, 0], GUESS[0, 0] + 1.0)


def test_a_method_from_an_accurate_guess_starts_once():
    state, most = restarted(Threshold(0.0, FINE), PROBLEM, GUESS, jnp.array(True), jnp.array(False))
    np.testing.assert_array_equal(state.z, GUESS)
    assert np.all(np.isinf(most))


def assert_flies(seed, planner):
    """A chain of boxes, planned and judged by SciPy."""
    from benchmarks.robustness.chains import chain
    from benchmarks.robustness.judge import refuted

    scenario = chain(seed).scenario
    solution = planner(scenario)
    assert jaxscp.status_names(solution.status) == "converged"
    assert not refuted(scenario, solution)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:corridor:UserWarning")  # the boxes of a chain bound the vehicle's centre
@pytest.mark.parametrize("seed", [93, 107, 110, 274, 442, 717, 731])
def test_chains_that_need_a_finer_mesh(seed):
    """From the first guess alone, one interval of each is so long that the certificate refutes the plan."""
    assert_flies(seed, jaxscp.Planner())


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:corridor:UserWarning")
@pytest.mark.parametrize("seed", [3221, 4577, 4958, 5730, 6653, 6768])
def test_chains_that_need_intervals_on_short_legs(seed):
    """With one or two intervals on short legs or before the last one, few guesses lead to a plan, or none."""
    assert_flies(seed, jaxscp.Planner())


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:corridor:UserWarning")
@pytest.mark.parametrize("seed", [27, 54])
def test_chains_of_turns_that_need_a_slower_guess(seed):
    """Each has a motion that can be flown; from its first guess, 30 nodes end in ``dynamics_unmet``."""
    assert_flies(seed, jaxscp.Planner(nodes=30))
