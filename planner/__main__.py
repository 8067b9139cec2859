"""``python -m planner`` is the command ``tandem``."""

import sys


def main() -> None:
    """Entry point of the command; a Ctrl-C while modules are still read is no fault either."""
    try:
        from planner.files import unhurried
        from planner.geometry.memory import lasting, own_process

        own_process()
        with unhurried(), lasting():  # an import that is interrupted may swallow it
            from planner.cli.command_line import main as command
    except KeyboardInterrupt:
        sys.exit(130)
    command()


if __name__ == "__main__":
    main()
