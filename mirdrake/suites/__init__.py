"""Suites: the tests of world files, each with all its variations, run in worker processes.

::

    world.yaml ── collect_cases ──► [Case] ── run_suite ──► Suite of [Result], one verdict each
                                │
                                └── search ──► the parameter values with the smallest margin

Verdicts: ``pass``, ``fail`` (a requirement does not hold), ``error`` (it could not be judged: it hung, crashed, raised
an error or diverged), ``invalid`` (the world cannot be laid out, or violates its own rules).
"""

from mirdrake.suites.cases import Case, Result, Verdict, collect_cases, collect_searches, vary
from mirdrake.suites.run import Suite, load_suite, run_suite
from mirdrake.suites.search import SearchResult, Trial, search

__all__ = [
    "Case", "Result", "SearchResult", "Suite", "Trial", "Verdict", "collect_cases", "collect_searches",
    "load_suite", "run_suite", "search", "vary",
]  # fmt: skip
