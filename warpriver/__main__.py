"""``python -m warpriver``."""

import sys

from warpriver.cli import main

sys.exit(main())
