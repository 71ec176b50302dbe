"""Results as text: tables, numbers, hints."""
