"""Offline analysis of robots, trajectories and recordings."""
