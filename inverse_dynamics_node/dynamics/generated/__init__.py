"""Code generated for one robot; optional: nothing else in the package imports it."""
