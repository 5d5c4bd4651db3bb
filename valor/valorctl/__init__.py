"""The command line that starts, watches, drives and stops a robot system."""
