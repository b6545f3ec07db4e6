"""Array types, statuses, batched loops: nothing here knows a problem."""
