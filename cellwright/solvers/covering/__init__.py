"""Choosing the fewest candidates that cover all rows: bounds, heuristics and the exact search behind `set_cover`."""
