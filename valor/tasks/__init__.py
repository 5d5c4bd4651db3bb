"""What an operator has a robot do with its hands: where it shall stand, and where its hand shall go.

``door`` and ``valve`` make a ``Plan`` of what is seen (``seen``) and of the hand's shape (``hand_shape``): pure
functions, by which nothing moves. Whoever carries one out takes its steps and sends its hand goals.
"""
