"""Identification: from recorded drives to the parameters of a model.

::

    drives.yaml ── load_data ──► DataSet ── check_data ──► DataReport with the repaired data
    study.yaml ── load_identification ──► StudySpec ── identify.identify ──► Fit, its folder and report.html

:mod:`~mirdrake.identification.models` contains the equations of the vehicles, and
:mod:`~mirdrake.identification.estimators` fits them: a :class:`Fit` has parameters with intervals and verdicts, and the
"""

from mirdrake.identification.check import check_data
from mirdrake.identification.data import DataSet, Log, load_data
from mirdrake.identification.findings import DataReport, Excitation, Finding
from mirdrake.identification.fit import Fit, load_fit
from mirdrake.identification.study import load_identification

__all__ = [
    "DataReport", "DataSet", "Excitation", "Finding", "Fit", "Log", "check_data", "load_data", "load_fit",
    "load_identification",
]  # fmt: skip
