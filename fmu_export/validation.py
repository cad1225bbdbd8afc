"""What fmpy's validation says of a file, in a thousandth of its time.

Nearly all of that goes to its grammar of structured names, which is a regular expression here.
"""

from __future__ import annotations

import re
import zipfile

from fmpy.model_description import ValidationError, read_model_description

_WORD = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
_NAME = re.compile(rf"(der\({_WORD}(\.{_WORD})*\)|{_WORD}(\.{_WORD})*)\Z", re.ASCII)
"""FMI 2.0.4, section 2.2.9; FMI 3.0.2, section 2.4.7.5.1; of what it allows, what is used here."""


def problems_of(filename: str) -> list[str]:
    """What is wrong with an FMU: modelDescription.xml, an empty library."""
    with zipfile.ZipFile(filename) as archive:
        empty = [f"{f.filename} is empty" for f in archive.filelist if not f.file_size]
    if empty:
        return empty
    try:
        found = read_model_description(filename, validate=True, validate_model_structure=True)
    except ValidationError as error:
        return list(error.problems)
    names = [v.name for v in found.modelVariables]
    if found.variableNamingConvention != "structured":
        return []
    return [f"'{name}' is no structured name" for name in names if not _NAME.match(name)]
