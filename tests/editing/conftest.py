from cli.conftest import motionkit  # noqa: F401
