"""The command line: what the library knows, for people; no ROS is needed but for the demo."""
