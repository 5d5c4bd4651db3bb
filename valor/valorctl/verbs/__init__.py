"""The verbs of the command line, one module a group: they read the options, call what does the work, and print."""
