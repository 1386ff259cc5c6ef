"""Requests of connected clients in, frames of live characters out: the server of `motionkit play`."""
