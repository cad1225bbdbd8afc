"""Limits on what one file or plan may take of the machine. The error at a limit names it.

Raise a limit if you trust a file or know what you plan: ``contact_system.limits.PANELS = 5e6``.
"""

SCENE_BYTES = 2e6
"""Size of a scene's TOML text; a disturbance takes about 150."""
NESTING = 32
"""Dots of a key in a scene file."""
FORMULA_LENGTH = 10_000
"""Characters of a formula."""
FORMULA_NESTING = 200
"""Depth of nested operations in a formula; a sum of n terms counts n - 1."""
COEFFICIENTS = 64
"""Coefficients of a polynomial of time, such as a profile."""
WINDOWS = 1e4
"""Disturbances of a scene; one on all contacts counts once for each of them."""
PANELS = 5e5
"""Panels of all contacts of a plan together, rejected ones included; each takes 5 to 20 us, or 1 ms
with formulas of thousands of characters, and up to 2 kB."""
EVALUATIONS = 1.2e5
"""Evaluations of the chart equations in a plan of ``method="chart"``: 10 us each, up to 100 us more
with an implicit solver."""
STRIPS = 1e4
"""Strips between neighbouring directions that a search for geodesics from one point examines; each
takes up to 5 ms. A search needs many where the least radius of curvature is tiny, or on a surface
with many waves between the points."""
PLAN_BYTES = 5e7
"""Unpacked size of a saved plan's restart data."""
MESSAGE = 1000
"""Characters of an error's text; the middle of a longer one is left out."""
