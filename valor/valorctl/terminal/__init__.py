"""The command line: verbs, options, progress, errors and interruption."""
