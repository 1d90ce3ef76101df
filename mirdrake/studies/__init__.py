"""Studies: many variations of one diagram, spread over processes or computers.

::

    study.yaml ── load_study ──► StudySpec ── run_study ──► StudyResult, one row a run
                                               │
                                               └── make_plan ──► jobs ── run_job (any Executor) ──► outcomes

A parameter is a dotted path of the diagram file (each of its values is built once in a worker), or a knob of
:mod:`mirdrake.execution.parameters`, which changes the Context and nothing needs to be built. Status of a run: ``ok``,
``unstable`` (it diverged) or ``failed`` (it raised, hung, crashed or could not be measured).
"""

from mirdrake.execution.parameters import Knob, find_knobs
from mirdrake.execution.workers import Workers
from mirdrake.studies.run import StudyResult, load_results, run_study
from mirdrake.studies.spec import StudySpec, load_study, make_study

__all__ = [
    "Knob", "StudyResult", "StudySpec", "Workers", "find_knobs", "load_results", "load_study", "make_study",
    "run_study",
]  # fmt: skip
