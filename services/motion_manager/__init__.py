"""Motion Manager: behaviors, command handlers and whole-body control; the one writer of ``motion_manager/motor``."""
