"""Reading and writing of bags as blocks of messages; all format-specific code is here."""
