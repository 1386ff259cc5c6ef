"""Motion in, something to look at out (optional extras)."""
