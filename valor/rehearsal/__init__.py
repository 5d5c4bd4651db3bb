"""A robot played in one process, without sockets: what a person would try first, rung by rung.

``closed_loop`` is plant and Whole-Body Controller; ``plan_walk`` walks a footstep plan in it; ``rungs`` says what a
robot must do, and how it did. ``python -m valor.rehearsal`` plays one actuator profile.
"""
