"""``python -m understudy`` is the command ``understudy``."""

import sys

from understudy.command.cli import main

sys.exit(main())
