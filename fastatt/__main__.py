"""``fastatt`` and ``python -m fastatt``."""

import sys


def main() -> int:
    """Run one command. Ctrl-C ends it with one line, also while modules are being imported."""
    try:
        from fastatt.cli import main as run

        return run()
    except KeyboardInterrupt:
        print("fastatt: stopped", file=sys.stderr)
        return 130


# processes that the command starts import this file too
if __name__ == "__main__":
    sys.exit(main())
