"""Sphere hulls with a certificate. Enter by `fitting`, or by `robots` for whole robots."""
