"""The version of the release."""

__version__ = "0.2.0"
