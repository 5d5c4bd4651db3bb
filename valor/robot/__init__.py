"""What a robot is: tables and what must hold between them, models, how joints may be led. Read from its folder."""
