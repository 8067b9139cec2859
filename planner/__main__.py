"""Entry point for ``python -m planner``, which is the command ``tandem``."""

import sys


def main() -> None:
    """Run the command line. Ctrl-C during the imports exits with code 130 instead of a traceback."""
    try:
        from planner.files import deferred_sigint
        from planner.runtime.memory import gc_frozen, mark_own_process

        mark_own_process()
        with deferred_sigint(), gc_frozen():  # an interrupted import may lose the signal
            from planner.cli.command_line import main as run_command_line
    except KeyboardInterrupt:
        sys.exit(130)
    run_command_line()


if __name__ == "__main__":
    main()
