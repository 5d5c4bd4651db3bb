"""What comes in from outside, one module a topic: checked, and refused with its reason or handed on."""
