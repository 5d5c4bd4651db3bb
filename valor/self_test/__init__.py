"""Self-test of a robot in one process, without sockets: acceptance tests of plant and Whole-Body Controller.

``closed_loop`` couples both; ``plan_walk`` walks a footstep plan; ``acceptance`` has the tests and their limits.
``python -m valor.self_test`` runs them under one actuator profile.
"""
