"""A running robot before tools and programs that know its public names alone."""
