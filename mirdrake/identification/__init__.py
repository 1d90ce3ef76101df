"""Identification: from recorded drives to the parameters of a model.

So far the first half: recorded drives into a data set of channels with canonical names and SI units, and the check that
comes before any fit::

    data = load_data("drives.yaml")          # format mirdrake: data/1, see mirdrake.identification.spec
    report = check_data(data)
    print(report.table())
    report.data                              # with the repairs that the report lists
"""

from mirdrake.identification.check import check_data
from mirdrake.identification.data import DataSet, Log, load_data
from mirdrake.identification.findings import DataReport, Excitation, Finding

__all__ = ["DataReport", "DataSet", "Excitation", "Finding", "Log", "check_data", "load_data"]
