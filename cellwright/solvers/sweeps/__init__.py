"""Scan sweeps: their poses, how they are followed, trimmed, ordered and kept as pieces."""
