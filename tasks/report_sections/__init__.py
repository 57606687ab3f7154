"""Sections of reports that are too large for the stage that writes the page."""
