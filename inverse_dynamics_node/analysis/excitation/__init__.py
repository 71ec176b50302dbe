"""Designs a motion for an accurate identification of masses and friction."""
