"""Pictures and reports: drawing only here."""
