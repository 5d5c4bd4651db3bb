"""The operator's page: the robot as it is, and what may be asked of it, previewed before anything moves."""
