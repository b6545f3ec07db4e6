"""The paper's take-off anomaly: against suction, a command of 0.5 m fails and one of 1.0 m succeeds."""

import numpy as np
import pytest


@pytest.mark.nightly
def test_half_a_metre_fails_and_a_metre_succeeds():
    from benchmarks.take_off import LEFT, climbs

    height, share = climbs()
    assert height[:, 0].max() < 0.02  # on the deck
    assert (height[:, 1].max(axis=1) > LEFT).all()
    assert 0.42 < share[:, 1].max() < 0.6  # the paper's peak is near 45 to 49 %
    assert np.isfinite(height).all()
