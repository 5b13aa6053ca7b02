"""``fastatt`` and ``python -m fastatt``."""

import os
import sys


def main() -> int:
    """Run one command; what fails or Ctrl-C interrupts, imports too, ends with one line."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
    try:
        from fastatt.cli import main as run

        return run()
    except ImportError as error:
        print(f"fastatt: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("fastatt: stopped", file=sys.stderr)
        return 130


# processes that the command starts import this file too
if __name__ == "__main__":
    sys.exit(main())
