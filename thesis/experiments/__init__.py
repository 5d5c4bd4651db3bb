"""The thesis' experiments: each starts and records a system, analyses the recording, and saves figures and a result."""
