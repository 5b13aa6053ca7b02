"""``python -m fastatt``."""

import sys

from fastatt.cli import main

# processes that the command starts import this file too
if __name__ == "__main__":
    sys.exit(main())
