"""Identification of the parameters of an arm's drives and links from its sensors."""
