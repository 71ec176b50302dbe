"""Reads, smooths, differentiates and resamples recordings."""
