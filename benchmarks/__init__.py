"""Benchmarks: each task beside what one would use for it without this library."""
