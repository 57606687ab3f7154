"""Cell layout by true cycle time: the problem, its solvers and the gate that judges them. Enter by `optimiser`."""
