"""Benchmarks against other libraries; `make bench` writes doc/evidence/benchmarks.md."""
