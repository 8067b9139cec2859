"""``python -m planner`` is the command ``tandem``."""

import sys


def main() -> None:
    """Entry point of the command; a Ctrl-C while modules are still read is no fault either."""
    try:
        from planner.files import deferred_sigint
        from planner.runtime.memory import gc_frozen, mark_own_process

        mark_own_process()
        with deferred_sigint(), gc_frozen():  # an import that is interrupted may swallow it
            from planner.cli.command_line import main as command
    except KeyboardInterrupt:
        sys.exit(130)
    command()


if __name__ == "__main__":
    main()
