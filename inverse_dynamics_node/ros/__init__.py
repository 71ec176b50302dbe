"""Plumbing between ROS and the core, without policy."""
