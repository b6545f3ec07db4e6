"""How fast: against rivals, piece by piece, by size, from a cold start and in batches."""
