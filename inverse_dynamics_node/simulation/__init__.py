"""MuJoCo in place of the robot hardware, and the demo."""
