"""Planning algorithms on arrays and cell objects."""
