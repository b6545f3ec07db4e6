"""How often plans of random scenes converge, keep what they promise, and may be planned again."""
