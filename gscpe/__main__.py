# SPDX-License-Identifier: Apache-2.0
"""``python -m gscpe`` is ``gscpe``."""

import sys

from gscpe.cli import main

sys.exit(main())
