"""``python -m gscpe`` is ``gscpe``."""

import sys

from gscpe.cli.main import main

sys.exit(main())
