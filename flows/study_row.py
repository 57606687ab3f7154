"""What the rows of all studies have in common, whatever their flow."""

from __future__ import annotations

MADE = "made"
"""Key of what a row's run has made, for pictures and recordings; it is no column."""
