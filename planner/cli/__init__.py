"""The command ``tandem``: one module per group of subcommands."""
