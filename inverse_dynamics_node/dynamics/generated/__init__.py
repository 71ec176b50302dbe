"""Code generated for one robot; no other module of the package imports it."""
