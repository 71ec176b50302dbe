"""The command-line program `inverse_dynamics`. Most of its commands run without ROS."""
