"""Compares model and robot while the node runs."""
