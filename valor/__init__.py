"""An open humanoid control stack. The services' folders stand in ``services/`` and are linked here."""
