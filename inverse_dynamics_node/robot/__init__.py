"""Robot models, and functions that load them from URDF."""
