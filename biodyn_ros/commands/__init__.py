"""The subcommands of `biodyn`, a module each, and how they are parsed."""
