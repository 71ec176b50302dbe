"""A robot to try the node on: MuJoCo plays the hardware behind joint states and commands."""
