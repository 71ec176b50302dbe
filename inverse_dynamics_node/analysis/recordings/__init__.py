"""Reads recordings from files, resamples them at uniform times, smooths and differentiates."""
