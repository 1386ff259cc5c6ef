"""The networks and inputs of the models' room, for tests of the step that runs them."""

from models.conftest import make_inputs, make_network

__all__ = ["make_inputs", "make_network"]
