"""``python -m understudy`` is the command ``understudy``."""

from understudy.command.cli import main

raise SystemExit(main())
