"""Drivers of the states of the Locomotion FSM."""
