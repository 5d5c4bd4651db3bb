"""Motions planned ahead by optimisation: key poses that stand by themselves on what touches the floor.

``python -m valor.planning ROBOT`` makes a robot's ``get_up.yaml`` from its ``get_up_plan.yaml``.
"""
