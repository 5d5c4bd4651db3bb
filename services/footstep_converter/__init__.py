"""Footstep Converter: checks ViGIR's footstep plans and sends them to the Motion Manager (thesis 4.1.2)."""
