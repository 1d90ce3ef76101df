"""``python -m mirdrake``, the same as the command ``mirdrake``."""

import sys

from mirdrake.cli import main

sys.exit(main())
