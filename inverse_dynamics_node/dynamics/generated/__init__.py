"""Code generation for one robot."""
