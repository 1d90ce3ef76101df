"""Identification: from recorded drives to the parameters of a model.

::

    drives.yaml ── load_data ──► DataSet ── check_data ──► DataReport, and the data with the repairs that it lists
    study.yaml ── load_identification ──► StudySpec ── identify.identify ──► Fit, its folder and report.html

:mod:`~mirdrake.identification.models` say how a vehicle moves, :mod:`~mirdrake.identification.estimators` make a
:class:`Fit` of a model and data: parameters with intervals and verdicts, and how well drives held out are met.
:mod:`~mirdrake.identification.online` follows a few parameters while driving.
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
