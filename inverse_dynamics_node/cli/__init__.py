"""The command `inverse_dynamics`; most of its subcommands do not need ROS."""
