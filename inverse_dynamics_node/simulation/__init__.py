"""The demo, and a simulated robot that replaces the robot hardware."""
