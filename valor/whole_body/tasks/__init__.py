"""What the QP's objective wants."""
