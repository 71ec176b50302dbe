"""MuJoCo models of robots and their surroundings."""
