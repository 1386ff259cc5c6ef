"""One or two motions in, named measures out."""
