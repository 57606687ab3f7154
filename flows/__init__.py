"""What a user runs: Prefect flows, the stage runner, requests made of cell files, the command line."""
