"""The Footstep Converter: ViGIR's footstep plans, checked and passed to the Motion Manager (thesis 4.1.2)."""
