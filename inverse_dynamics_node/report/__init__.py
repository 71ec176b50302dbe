"""Writes results as text: tables, numbers and hints."""
