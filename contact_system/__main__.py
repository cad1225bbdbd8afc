"""``python -m contact_system``: the command line."""

import sys

from .cli import main

sys.exit(main())
