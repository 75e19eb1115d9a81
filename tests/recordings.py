"""Where the recordings of others lie: beside the checkout, and not part of it.

Tests that need them are marked `recordings` and skipped where the folder is absent.
"""

from pathlib import Path

RECORDINGS = Path(__file__).parents[2] / "shared" / "data"
