"""Benchmarks against other libraries: `make bench` runs them and writes doc/benchmarks.md."""
