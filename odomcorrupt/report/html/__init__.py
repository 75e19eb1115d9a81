"""Results as one page of HTML."""
