"""Names of ``worlds.WORLDS``, without importing MuJoCo."""

WORLD_NAMES = ("flat", "dirt", "stairs", "stairs_15cm", "rubble", "door", "door_shut", "valve", "valve_stuck")
