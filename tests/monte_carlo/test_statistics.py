"""Intervals have the coverage that they state; stop rules look as they say; sensitivities agree with closed forms."""

import dataclasses

import numpy as np
import pytest
import scipy.stats
from scipy.special import ndtri

from jaxscp import monte_carlo as mc
from jaxscp.monte_carlo.stopping import Observed, corrected_level, least_coverage, looks

CASES, SWEEPS = 1000, 20_000
LEAST, MOST = 0.94, 0.97  # asked coverage of 95 % intervals
WIDTH = 0.1
INDEX = 0.05  # of Sobol indices from 1024 base samples
STEP = 2e-3  # of the grid of errors at which coverage is computed


@pytest.mark.parametrize("rule", [None, mc.NarrowShare(WIDTH)], ids=["all cases", "stop rule"])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_intervals_cover(probability, rule):
    share, _ = mc.simulated_coverage(probability, CASES, rule, SWEEPS)
    assert LEAST < share < MOST


@pytest.mark.parametrize("width", [0.2, 0.15, 0.12, 0.1, 0.08, 0.06, 0.05, 0.04, 0.03, 0.02])
@pytest.mark.parametrize("probability", [0.3, 0.5, 0.7, 0.9, 0.99])
def test_no_width_covers_too_rarely(probability, width):
    """Near 0 and 1, few failures make intervals of any kind wider than needed: only the lower limit is asked."""
    share, _ = mc.simulated_coverage(probability, CASES, mc.NarrowShare(width), SWEEPS)
    assert share > LEAST


def test_without_a_correction_some_thresholds_cover_too_rarely():
    assert least_coverage(float(ndtri(0.975))) < 0.936
    assert least_coverage(float(ndtri(0.5 + corrected_level(0.95) / 2))) == pytest.approx(0.95, abs=1e-9)


def test_least_coverage_is_that_of_simulated_looks():
    rng, z = np.random.default_rng(0), 2.0
    first = rng.standard_normal(400_000)
    second = np.sqrt(0.5) * (first + rng.standard_normal(len(first)))
    covers = [
        np.mean(np.where(first > c, np.abs(first) < z, np.abs(second) < z)) for c in np.linspace(0.0, 3.0, 31)
    ]
    assert least_coverage(z) == pytest.approx(min(covers), abs=STEP)


def test_wilson_is_scipys():
    for successes, count in ((0, 10), (3, 10), (990, 1000), (10, 10)):
        ours = mc.wilson(successes, count)
        theirs = scipy.stats.binomtest(successes, count).proportion_ci(method="wilson")
        np.testing.assert_allclose(ours[1:], (theirs.low, theirs.high), atol=1e-12)


def test_the_mean_is_students():
    values = np.random.default_rng(1).exponential(size=40)
    theirs = scipy.stats.ttest_1samp(values, 0.0).confidence_interval()
    np.testing.assert_allclose(mc.mean_interval(np.append(values, np.nan))[1:], theirs, rtol=1e-9)


def seen(values, complete):
    return Observed(complete, len(values), 0.0, lambda name, n: values[:n])


def test_the_rule_ends_at_the_first_narrow_look_whatever_is_known_later():
    values = np.random.default_rng(2).uniform(size=CASES) < 0.9
    ends = {
        complete: mc.NarrowShare(WIDTH).ended(seen(values, complete)) for complete in (0, 124, 300, 600, 1000)
    }
    found = ends[1000]
    assert found is not None
    assert found.cases in looks(CASES, None)
    assert all(end is None or end == found for end in ends.values())
    assert found.interval == mc.wilson(int(values[: found.cases].sum()), found.cases, corrected_level(0.95))


def test_the_rule_of_a_mean():
    values = np.random.default_rng(3).normal(5.0, 1.0, CASES)
    found = mc.NarrowMean("cost", 0.4).ended(seen(values, CASES))
    assert found.interval.width <= 0.4
    assert found.cases < CASES


def ishigami(case):
    a, b, c = (case[name] for name in "abc")
    return {"y": np.sin(a) + 7.0 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)}


def study(sampling):
    limits = mc.Uniform(-np.pi, np.pi)
    parameters = tuple(mc.Parameter(name, limits) for name in "abc")
    return mc.Study(ishigami, {name: 0.0 for name in "abc"}, parameters, sampling)


def test_sobol_indices_of_correlated_parameters_are_refused(tmp_path):
    correlated = dataclasses.replace(study(mc.Saltelli(8, 3)), correlations={("a", "b"): 0.9})
    with pytest.raises(mc.InvalidStudy, match="correlated"):
        mc.sobol_indices(mc.sweep(correlated, tmp_path / "s"), "y")


def test_sobol_indices_are_ishigamis(tmp_path):
    """Ishigami and Homma (1990): closed forms of the indices."""
    found = mc.sobol_indices(mc.sweep(study(mc.Saltelli(1024, 3)), tmp_path / "s", chunk=5120), "y")
    v1, v2, v13 = 0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0.01 * np.pi**8 * (1 / 18 - 1 / 50)
    total = v1 + v2 + v13
    np.testing.assert_allclose([e.value for e in found["first"]], [v1 / total, v2 / total, 0.0], atol=INDEX)
    np.testing.assert_allclose(
        [e.value for e in found["total"]], [(v1 + v13) / total, v2 / total, v13 / total], atol=INDEX
    )


def test_rank_correlations_are_scipys_and_hold_their_value(tmp_path):
    found = mc.sweep(study(mc.Independent(500, 1)), tmp_path / "s", chunk=500)
    for effect in mc.rank_correlations(found, "y"):
        r = scipy.stats.spearmanr(found.values(effect.parameter), found.values("y")).statistic
        assert effect.value == pytest.approx(r)
        assert effect.lower < r < effect.upper


def test_the_summary(tmp_path):
    def run(case):
        return {"success": case["x"] > 0.25, "violation": abs(case["x"] - 0.5), "cost": case["x"]}

    planned = mc.Study(run, {"x": 0.0}, (mc.Parameter("x", mc.Uniform(0, 1)),), mc.Independent(400, 1))
    result = mc.sweep(planned, tmp_path / "s", chunk=400)
    found = mc.summarise(result, resamples=200)
    x = result.values("x")
    assert found.share == mc.wilson(int(np.sum(x > 0.25)), 400)
    assert found.quantiles["cost"][0.5].estimate == np.median(x[x > 0.25])
    low, high = found.quantiles["cost"][0.5][1:]
    assert low < 0.625 < high
    assert found.violations["violation"] == np.max(np.abs(x - 0.5)[x > 0.25])
    assert found.worst[0] == np.argmin(x)  # the failure with the greatest violation
    assert "success: " in str(found)


def test_intervals_of_a_mean_cover_under_the_stop_rule():
    """Student's interval of skewed values; 1000 sweeps leave a standard error of 0.7 %."""
    rng, held = np.random.default_rng(4), 0
    for _ in range(1000):
        values = rng.exponential(size=400)
        found = mc.NarrowMean("cost", 0.25, first=100).ended(seen(values, 400))
        held += found.interval.lower <= 1.0 <= found.interval.upper
    assert 0.93 < held / 1000 < 0.98


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 0.0, -1.0])
def test_rules_refuse_numbers_out_of_range(number):
    for rule, name in (
        (lambda: mc.Budget(number), "seconds"),
        (lambda: mc.NarrowShare(number), "width"),
        (lambda: mc.NarrowMean("cost", number), "width"),
        (lambda: mc.NarrowShare(0.1, confidence=number), "confidence"),
    ):
        with pytest.raises(mc.InvalidStudy, match=f"{name}: must"):
            rule()
    with pytest.raises(mc.InvalidStudy, match="first: must be 1 or more"):
        mc.NarrowShare(0.1, first=0)


def test_a_share_is_of_a_boolean_result():
    observed = Observed(8, 8, 1.0, lambda name, cases: np.linspace(0.0, 1.0, cases))
    with pytest.raises(mc.InvalidStudy, match="of: reach has the type float64"):
        mc.NarrowShare(0.1, of="reach").ended(observed)
