"""MuJoCo as the robot hardware, and the demo."""
