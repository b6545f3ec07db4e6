"""Shares of random scenes whose plans converge, are not refuted, and can be planned again."""
