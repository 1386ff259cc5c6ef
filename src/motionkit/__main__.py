"""`python -m motionkit`, which torchrun needs."""

from motionkit.cli.main import main

main()
