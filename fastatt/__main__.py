"""``python -m fastatt``."""

import sys

from fastatt.cli import main

sys.exit(main())
