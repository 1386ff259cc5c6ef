"""A model and its recordings in, a verdict on each of its types out: does it work, and if not, why?"""
