"""The Whole-Body Controller: estimate, balance, walk, fall detection (thesis 3.4.2; docs/whole_body_controller.md).

The Motion Manager leads a robot by it; the balance reflex, which the Comms Manager keeps, brings one to stand by it.
"""
