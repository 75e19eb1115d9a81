"""What a bag is like before it is corrupted: one pass over it, what is odd, a portrait."""
