"""Reads recordings from files, and resamples, smooths and differentiates them."""
