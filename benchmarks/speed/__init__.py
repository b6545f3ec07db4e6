"""Benchmarks of speed: rivals, parts of a solve, sizes, cold starts and batches."""
