"""Words typed by a user in, one library call out; one file per subcommand."""
