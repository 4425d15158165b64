"""Benchmarks: how fast a part is, beside what else does the same work on the same machine."""
