"""Offline planning of Get Up by optimisation: ``python -m valor.get_up_planning ROBOT`` makes ``get_up.yaml``."""
