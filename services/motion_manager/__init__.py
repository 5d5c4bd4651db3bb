"""Motion Manager: behaviors, command handlers and joint control; the only publisher of ``motion_manager/motor``."""
