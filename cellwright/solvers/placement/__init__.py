"""Where part or robot should stand so that given sweeps take a short cycle. `search` finds, `trial` makes sure."""
