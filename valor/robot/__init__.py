"""What a robot is: its tables and what must hold between them, its models, and how its joints may be led. Read from its folder."""
