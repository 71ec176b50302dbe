"""The command-line program `inverse_dynamics`, which mostly runs without ROS."""
