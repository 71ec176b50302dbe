"""Connects ROS to the other parts of the package."""
