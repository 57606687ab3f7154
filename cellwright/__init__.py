"""Cellwright's pure library: the modelled robot cell (`cell`) and the planning algorithms (`solvers`).

It knows no lake and no Prefect, writes no files, keeps no state, and takes its random generators as arguments.
"""
