"""Robot models, and reading them from URDF."""
