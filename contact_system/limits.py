"""What one file or plan may ask of a machine; each error that comes of a limit names it.

Set one where you trust what you load or know what you plan:
``contact_system.limits.PANELS = 5e6``.
"""

SCENE_BYTES = 1e6
"""Of a scene's TOML text."""
NESTING = 32
"""Lists and tables inside each other in a scene file, and parts of a dotted key."""
FORMULA_LENGTH = 10_000
"""Characters of a formula."""
FORMULA_NESTING = 200
"""Operations inside each other in a formula; a sum of n terms has n - 1."""
COEFFICIENTS = 64
"""Of a polynomial of time, such as a profile."""
WINDOWS = 10_000
"""Disturbances of a scene, one that acts on all contacts counted once each."""
PANELS = 500_000
"""Panels that all contacts of a plan take together, those that were tried and shortened included:
5 to 20 us and up to 2 kB each."""
EVALUATIONS = 120_000
"""Of the chart equations in a plan of ``method="chart"``: 10 us each, and up to 100 us of an
implicit solver's own."""
PLAN_BYTES = 5e7
"""What a saved plan's restart data unpack to."""
ARCHIVE_DIRECTORY = 2e6
"""Bytes of an archive's table of contents, some 100 for each file."""
FMU_BYTES = 2e9
"""What an FMU unpacks to."""
DESCRIPTION_BYTES = 5e7
"""Of an FMU's modelDescription.xml."""
FMU_ELEMENTS = 1_000_000
"""Elements of all variables that an FMU declares, arrays included."""
MESSAGE = 1000
"""Characters of an error's text; the middle of a longer one is left out."""
