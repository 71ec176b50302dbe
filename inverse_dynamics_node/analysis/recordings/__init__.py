"""Recordings: read from files, resampled at uniform times, smoothed and differentiated."""
