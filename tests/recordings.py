"""Where recordings lie: ours in the checkout, and those of others beside it, which are no part of it.

Tests that need the others are marked `recordings` and skipped where the folder is absent.
"""

from pathlib import Path

ROOT = Path(__file__).parents[1]
FIXTURES = ROOT / "fixtures"
OFFICE = FIXTURES / "office.mcap"
RECORDINGS = ROOT.parent / "shared" / "data"
