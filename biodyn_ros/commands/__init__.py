"""The subcommands of `biodyn`, one module each, and their parser."""
