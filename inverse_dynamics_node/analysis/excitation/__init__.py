"""Designs a motion whose recording determines masses and friction as well as possible."""
