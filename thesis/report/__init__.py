"""Results of experiments and the report made of them."""
