"""What the QP must keep: contact forces, limits of joints, distances of parts."""
