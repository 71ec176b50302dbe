"""Computes commands from joint states and references, without ROS and without a clock."""
