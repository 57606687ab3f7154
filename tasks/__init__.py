"""The stages: one a module. This table of contents is what flows import."""
