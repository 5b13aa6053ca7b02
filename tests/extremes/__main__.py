"""``python -m extremes``."""

import sys

from extremes.page import main

if __name__ == "__main__":
    sys.exit(main())
