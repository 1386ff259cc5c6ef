"""One or two motions in, named numbers out."""
