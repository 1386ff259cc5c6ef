"""A motion of any rig in, the same rig out: loops, root motion, repairs."""
