"""A scene as a Functional Mock-up Unit (FMI 2.0 and 3.0), or stepped in this process."""

try:
    import fmpy  # noqa: F401
except ImportError as error:
    raise ImportError(
        "fmu_export needs fmpy, for FMI's headers and its validation: "
        f'pip install "contact-system[fmu]" ({error})'
    ) from error

from .export import export_fmu
from .reference import check_fmu
from .slave import PlannerSlave2, PlannerSlave3, in_process
from .ssp import export_ssp
from .variables import Table, Variable, variable_table

__all__ = [
    "PlannerSlave2",
    "PlannerSlave3",
    "Table",
    "Variable",
    "check_fmu",
    "export_fmu",
    "export_ssp",
    "in_process",
    "variable_table",
]
