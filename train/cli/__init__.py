"""The ``impact`` command: one file for each subcommand, with a class ``Command`` of its arguments and its ``run``."""
