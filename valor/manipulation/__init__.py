"""Manipulation plans from the observed fixture, without moving anything: a stance, and goals of the right hand."""
