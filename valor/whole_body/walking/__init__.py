"""Walking: footsteps, the DCM's plan over them, swinging feet (thesis 3.4.2; docs/whole_body_controller.md)."""
