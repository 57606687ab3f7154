"""Optimal control of an arm's dynamics by discrete mechanics. Enter by `solvers.optimal_control.motion`."""
