"""The names of the worlds to simulate in, for whoever asks for one and has no use for MuJoCo.

``worlds.WORLDS`` says what they are.
"""

WORLD_NAMES = ("flat", "dirt", "stairs", "stairs_15cm", "rubble", "door", "door_shut", "valve", "valve_stuck")
