"""``python -m mirdrake.cli``."""

import sys

from mirdrake.cli import main

sys.exit(main())
