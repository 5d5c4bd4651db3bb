"""Emulated devices for hardware-variant tests: one MuJoCo plant in real time and one emulator for each port."""
