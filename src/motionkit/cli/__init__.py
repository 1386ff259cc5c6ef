"""Command lines in, one library call out; one file per subcommand."""
