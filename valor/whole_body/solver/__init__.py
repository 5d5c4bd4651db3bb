"""QP: objective, elimination, solution."""
