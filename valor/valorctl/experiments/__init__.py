"""The thesis' experiments: each runs the live system, records, analyses, and leaves figures, CSV and a page."""
