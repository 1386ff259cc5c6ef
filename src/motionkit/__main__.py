"""Lets `python -m motionkit` run the command line; torchrun needs it."""

from motionkit.cli.main import main

main()
