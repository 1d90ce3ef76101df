"""Studies: many variations of one diagram, run on several processes or computers.

::

    study.yaml ── load_study ──► StudySpec ── run_study ──► StudyResult, one row a run
                                               │
                                               └── make_plan ──► jobs ── run_job (any Executor) ──► outcomes

A parameter is a dotted path of the diagram file, of which a worker builds each value once; or a context parameter of
:mod:`mirdrake.execution.parameters`, which is set in the Context of a built diagram. Status of a run: ``ok``,
``unstable`` (it diverged) or ``failed`` (it raised, hung, crashed or could not be measured).
"""

from mirdrake.execution.parameters import ContextParameter, find_context_parameters
from mirdrake.execution.workers import Workers
from mirdrake.studies.run import StudyResult, load_results, run_study
from mirdrake.studies.spec import StudySpec, load_study, make_study

__all__ = [
    "ContextParameter", "StudyResult", "StudySpec", "Workers", "find_context_parameters", "load_results", "load_study",
    "make_study", "run_study",
]  # fmt: skip
