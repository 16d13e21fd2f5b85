"""`python -m runtime.cli`, for a checkout that is not installed."""

import sys

from runtime.cli import main

sys.exit(main())
