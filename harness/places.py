"""Where things of the checkout are."""

from __future__ import annotations

from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
ROBOTS = REPOSITORY / "robots"
