"""Motion Manager: behaviors, command handlers, and who has the joints; the one writer of ``motion_manager/motor``."""
