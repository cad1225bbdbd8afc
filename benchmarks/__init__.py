"""Accuracy and speed of contact_system against bars: ``python -m benchmarks`` from a checkout."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # for references, and hosts of FMUs
