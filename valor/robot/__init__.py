"""What a robot is: its tables and what must hold between them, its models. Read from its folder."""
