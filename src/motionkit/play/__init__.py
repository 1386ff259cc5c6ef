"""Wishes of connected users in, frames of live characters out: the server of `motionkit play`."""
