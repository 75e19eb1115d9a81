"""Which effect is missing: score tests, refits, random causes, what nobody knows, and the loop over all."""
