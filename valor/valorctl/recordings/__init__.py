"""Recordings of an instance: listing, retention, conversion and playback."""
