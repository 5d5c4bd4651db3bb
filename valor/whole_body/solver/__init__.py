"""The QP: objective, elimination, solution."""
