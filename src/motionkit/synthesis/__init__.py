"""A model and controls in, motion out: one frame at a time, or whole."""
