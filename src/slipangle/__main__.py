"""``python -m slipangle``."""

import sys

from slipangle.cli import main

sys.exit(main())
