"""Cases: pure functions of seed and number; margins, correlations, leaves, identities."""

import dataclasses
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import jaxscp
from jaxscp import monte_carlo as mc
from jaxscp.monte_carlo.identity import described, differences
from jaxscp.monte_carlo.outcome import certificate_scalars
from jaxscp.verification.certificate import Certificate

COUNT = 4000
LEVEL = 1e-6  # of the tests of margins: one in a million seeds fails
CORRELATION = 0.05  # 4 standard errors of a rank correlation of 4000 pairs, rounded up

SAMPLERS = [mc.Independent(COUNT, 5), mc.LatinHypercube(COUNT, 5), mc.Sobol(COUNT, 5)]
BASE = {"mass": 1.0, "thrust": jnp.array([5.0, 5.0]), "wind": {"east": 0.0}}


def study(sampling, **more):
    parameters = (
        mc.Parameter(lambda b: b["mass"], mc.Normal(1.0, 0.1), unit="kg"),
        mc.Parameter(lambda b: b["thrust"], mc.Uniform(0.9, 1.1), change=mc.Scale()),
        mc.Parameter("wind.east", mc.Normal(0.0, 2.0), name="wind"),
    )
    return mc.Study(lambda b: {"mass": b["mass"]}, BASE, parameters, sampling, **more)


@pytest.mark.parametrize("sampling", SAMPLERS, ids=lambda s: type(s).__name__)
@pytest.mark.parametrize(
    "pairs", [{}, {("mass", "thrust"): 0.3, ("mass", "wind"): 0.7}], ids=["", "correlated"]
)
def test_case_n_depends_on_n_alone(sampling, pairs):
    planned = study(sampling, correlations=pairs)
    whole = planned.values(np.arange(COUNT))
    shuffled = np.random.default_rng(0).permutation(COUNT)
    np.testing.assert_array_equal(planned.values(shuffled), whole[shuffled])
    for number in range(0, COUNT, 37):
        np.testing.assert_array_equal(planned.values(np.array([number]))[0], whole[number])


@pytest.mark.parametrize("sampling", SAMPLERS, ids=lambda s: type(s).__name__)
def test_margins_are_the_distributions(sampling):
    values = study(sampling).values(np.arange(COUNT))
    for column, margin in zip(
        values.T,
        (scipy.stats.norm(1, 0.1), scipy.stats.uniform(0.9, 0.2), scipy.stats.norm(0, 2)),
        strict=True,
    ):
        assert scipy.stats.kstest(column, margin.cdf).pvalue > LEVEL


def test_another_seed_gives_other_cases_and_a_larger_count_keeps_them():
    first, second = (study(mc.Independent(100, seed)).values(np.arange(100)) for seed in (1, 2))
    assert np.all(first != second)
    np.testing.assert_array_equal(study(mc.Independent(10**9, 1)).values(np.arange(100)), first)


def test_another_process_gives_the_same_numbers():
    code = "import numpy; from jaxscp import monte_carlo as m; print(m.Independent(9, 5).points(numpy.array([7]), 2))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.strip() == str(mc.Independent(9, 5).points(np.array([7]), 2))


def test_a_latin_hypercube_has_one_case_a_slice():
    points = mc.LatinHypercube(50, 3).points(np.arange(50), 4)
    for column in points.T:
        np.testing.assert_array_equal(np.sort(np.floor(50 * column)), np.arange(50))


def test_a_grid_has_every_combination():
    choices = mc.Choice((1.0, 2.0, 4.0)), mc.Choice((-1.0, 1.0))
    parameters = [mc.Parameter(name, choice) for name, choice in zip("ab", choices, strict=True)]
    grid = mc.Study(lambda b: b, {"a": 0.0, "b": 0.0}, tuple(parameters), mc.Grid((3, 2)))
    found = {tuple(map(float, row)) for row in grid.values(np.arange(6))}
    assert found == {(a, b) for a in (1.0, 2.0, 4.0) for b in (-1.0, 1.0)}


def test_correlations_are_those_of_the_normal_scores():
    joint = study(mc.Independent(COUNT, 1), correlations={("mass", "wind"): 0.7})
    values = joint.values(np.arange(COUNT))
    assert np.corrcoef(values[:, 0], values[:, 2])[0, 1] == pytest.approx(0.7, abs=CORRELATION)
    assert np.corrcoef(values[:, 0], values[:, 1])[0, 1] == pytest.approx(0.0, abs=CORRELATION)
    assert scipy.stats.kstest(values[:, 2], scipy.stats.norm(0, 2).cdf).pvalue > LEVEL


@pytest.mark.parametrize(
    ("distribution", "oracle"),
    [
        (mc.Uniform(-1, 3), scipy.stats.uniform(-1, 4)),
        (mc.LogUniform(0.1, 10), scipy.stats.loguniform(0.1, 10)),
        (mc.Normal(2, 0.5, lower=1.5, upper=3.5), scipy.stats.truncnorm(-1, 3, 2, 0.5)),
        (mc.SciPy(scipy.stats.gamma(2.0)), scipy.stats.gamma(2.0)),
    ],
)
def test_quantiles_are_scipys(distribution, oracle):
    u = np.linspace(0.001, 0.999, 57)
    np.testing.assert_allclose(distribution.quantile(u), oracle.ppf(u), rtol=1e-9)


def test_weights_of_a_choice_are_probabilities():
    u = (np.arange(1000) + 0.5) / 1000
    assert np.mean(mc.Choice((0.0, 1.0), (3.0, 1.0)).quantile(u)) == pytest.approx(0.25)


def test_leaves_change_as_asked_and_no_others():
    planned = study(mc.Independent(10, 0))
    case, (mass, factor, wind) = planned.case(4), planned.values(np.array([4]))[0]
    assert (case["mass"], case["wind"]["east"]) == (mass, wind)
    np.testing.assert_array_equal(case["thrust"], 5.0 * factor * np.ones(2))
    assert isinstance(case["mass"], float)
    assert isinstance(case["thrust"], jax.Array)


def test_an_entry_of_an_array_and_a_leaf_of_a_scenario():
    scenario = jaxscp.scenarios.ascent_to_platform()
    moved = mc.Parameter(lambda s: s.goal.position, mc.Choice((0.25,)), "east", "m", index=0, change=mc.Add())
    case = mc.Study(lambda s: {}, scenario, (moved,), mc.Independent(1)).case(0)
    np.testing.assert_array_equal(case.goal.position - scenario.goal.position, [0.25, 0.0, 0.0])


def test_traced_values_give_the_same_case():
    planned = study(mc.Independent(10, 0))
    values = planned.values(np.array([2]))[0]
    traced = jax.jit(planned.insert)(values)
    jax.tree.map(np.testing.assert_array_equal, traced, planned.case(2))


@pytest.mark.usefixtures("no_type_checks")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mc.Parameter("mas", mc.Uniform(0, 1)).resolved(BASE), "no such leaf"),
        (lambda: mc.Parameter(lambda b: b["wind"], mc.Uniform(0, 1)).resolved(BASE), "not one leaf"),
        (lambda: mc.Parameter(lambda b: b["thrust"], mc.Uniform(0, 1)).resolved(BASE), "index="),
        (lambda: mc.Parameter("thrust", mc.Uniform(0, 1), index=5).resolved(BASE), "no entry 5"),
        (lambda: mc.Parameter("flag", mc.Uniform(0, 1)).resolved({"flag": True}), "only floats"),
        (lambda: mc.Uniform(1, 1), "lower < upper"),
        (lambda: mc.Uniform("a", 1), "Uniform: lower must be one number, got 'a'"),
        (lambda: mc.LogUniform(1, None), "LogUniform: upper must be one number, got None"),
        (lambda: mc.Normal(0, [1]), r"Normal: deviation must be one number, got \[1\]"),
        (lambda: mc.Choice(3), "Choice: values must be a tuple of numbers, got 3"),
        (lambda: mc.Choice((1, "b")), "Choice: values must be a tuple of numbers"),
        (lambda: mc.Choice((1, 2), 0.5), "Choice: weights must be a tuple of numbers, got 0.5"),
        (lambda: mc.Normal(0, 1, lower=40), "no probability"),
        (lambda: mc.Independent(0), "count must be"),
        (lambda: mc.Independent(True), "count must be"),
        (lambda: mc.Independent(5, seed=2**128), "seed must be less than"),
        (lambda: mc.Grid(3), "Grid: points_each must be a tuple of positive whole numbers"),
        (lambda: mc.Grid((2, 1.5)), "Grid: points_each must be"),
        (lambda: study(mc.Grid((2, 2))), "2 numbers, but the study has 3"),
        (lambda: study(mc.Independent(5), correlations={("mass", "x"): 0.5}), "no parameter is called 'x'"),
        (
            lambda: study(
                mc.Independent(5),
                correlations={("mass", "thrust"): 0.9, ("mass", "wind"): 0.9, ("thrust", "wind"): -0.9},
            ),
            "not positive definite",
        ),
        (
            lambda: study(mc.Independent(5), correlations={("mass", "wind"): 0.5, ("wind", "mass"): -0.5}),
            "given twice, with different numbers",
        ),
    ],
)
def test_wrong_requests_name_the_field(make, message):
    with pytest.raises(mc.InvalidStudy, match=message):
        make()


def test_equal_functions_are_the_same_study_and_others_say_what_differs():
    sampling = mc.Independent(10, 1)
    one, same = study(sampling).identity(), study(sampling).identity()
    assert differences(one, same) == []
    other = dataclasses.replace(study(sampling), sampling=mc.Independent(10, 2), run=lambda b: {"mass": 2.0})
    lines = "\n".join(differences(one, other.identity()))
    assert "sampling.seed: stored 1, now 2" in lines
    assert "run.code" in lines


def test_closures_and_arrays_count():
    def adding(x):
        return lambda b: b + x

    assert described(adding(1.0)) == described(adding(1.0)) != described(adding(2.0))
    assert described(jnp.arange(100.0)) != described(jnp.arange(100.0) + 1e-9)


FACTOR = 2.0


def helper(x):
    return FACTOR * x


def test_globals_and_functions_of_the_same_module_count(monkeypatch):
    before = described(lambda b: helper(b))
    assert before == described(lambda b: helper(b))
    monkeypatch.setitem(globals(), "FACTOR", 3.0)
    assert "globals.helper.globals.FACTOR: stored 2.0, now 3.0" in differences(
        before, described(lambda b: helper(b))
    )


def test_clearance_is_a_result_where_obstacles_are_known():
    none, one = jnp.zeros(0), jnp.zeros(1)
    rows = jnp.array(0.0), none, none, one, one, one, None, ("corridor",), (), ()
    assert certificate_scalars(Certificate(*rows, clearance=jnp.array(0.2)))["clearance"] == 0.2
    assert "clearance" not in certificate_scalars(Certificate(*rows))


def test_a_parameter_without_effect_is_refused():
    first, second = (
        mc.Parameter("x", mc.Uniform(0.0, 1.0), name, index=i) for name, i in (("a", -1), ("b", 2))
    )
    base = {"x": np.ones(3)}
    with pytest.raises(mc.InvalidStudy, match="'b': sets an entry of x that an earlier parameter changes"):
        mc.Study(lambda case: case, base, [first, second], mc.Independent(3))
    added = mc.Parameter("x", mc.Uniform(5.0, 6.0), "b", index=2, change=mc.Add())
    case = mc.Study(lambda case: case, base, [first, added], mc.Independent(3)).case(0)
    assert 5.0 < case["x"][2] < 7.0


@pytest.mark.usefixtures("no_type_checks")
@pytest.mark.parametrize("parameters", [mc.Parameter("x", mc.Uniform(0.0, 1.0)), [mc.Uniform(0.0, 1.0)]])
def test_parameters_are_a_list_of_them(parameters):
    with pytest.raises(mc.InvalidStudy, match="parameters: expected a list of Parameter"):
        mc.Study(lambda case: case, {"x": 1.0}, parameters, mc.Independent(3))
