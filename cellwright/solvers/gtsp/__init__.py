"""The generalised travelling-salesman problem: bounds, searches, lazy costs, files. Enter by `solvers.sequencing`."""
