"""The command `inverse_dynamics`; only its demo needs ROS."""
