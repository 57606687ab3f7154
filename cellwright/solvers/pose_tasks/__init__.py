"""Tasks at poses: their alternatives, the motions between them, and the sequence in which a robot performs them."""
