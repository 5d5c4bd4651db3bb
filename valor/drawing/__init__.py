"""The robot in its world, drawn without a display: for pictures, films, and the simulated camera."""
