"""Array types, statuses, errors, batched loops, and data that rooms share: nothing here knows a problem."""
