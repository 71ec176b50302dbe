"""From joint states and references to commands. No ROS, no clock."""
