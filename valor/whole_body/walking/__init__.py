"""Walking: footsteps, DCM plan, swinging feet (thesis 3.4.2; docs/whole_body_controller.md)."""
