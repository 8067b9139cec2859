"""The command ``tandem``: one module for each group of subcommands."""
