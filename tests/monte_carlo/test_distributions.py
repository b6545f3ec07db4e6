"""Distributions refuse parameters for which they have no values."""

import numpy as np
import pytest
import scipy.stats

from jaxscp import monte_carlo as mc


@pytest.mark.parametrize(
    ("frozen", "message"),
    [
        (
            scipy.stats.gamma(-1.0),
            r"scipy.stats.gamma has no values for -1.0; they are outside of their range",
        ),
        (scipy.stats.triang(c=2.0, loc=1.0), r"scipy.stats.triang has no values for c = 2.0, loc = 1.0"),
        (scipy.stats.norm(0.0, -1.0), "scipy.stats.norm has no values"),
        (scipy.stats.binom(n=5, p=2.0), "scipy.stats.binom has no values"),
    ],
)
def test_parameters_outside_of_their_range(frozen, message):
    with pytest.raises(mc.InvalidStudy, match=message):
        mc.SciPy(frozen)


def test_any_object_with_quantiles_is_a_distribution():
    class Own:
        def ppf(self, u):
            return 2.0 * u

    np.testing.assert_array_equal(mc.SciPy(Own()).quantile(np.array([0.25])), [0.5])
    assert mc.SciPy(scipy.stats.rv_histogram(([1, 2, 1], [0, 1, 2, 3]))).quantile(np.array([0.5])) == 1.5
