"""Results of a suite as JUnit XML, for continuous integration services.

The file conforms to the strictest of the schemas in use, that of Ant's JUnit task (windyroad's JUnit.xsd): a test
suite for each world file, a test case for each variation, `failure` for a failed requirement, `error` for the rest.
"""

import re
import socket
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from mirdrake.core.files import write_file
from mirdrake.core.yaml_io import display_path
from mirdrake.suites import Case, Result, Suite

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(suite: Suite, path: Path) -> Path:
    """Write the results of a suite as JUnit XML.

    Args:
        suite: its results, complete or not.
        path: file to write.

    Raises:
        RunError: the file cannot be written.
    """
    write_file(path, render_junit(suite))
    return path


def render_junit(suite: Suite) -> str:
    """Return the text of the file, with the present time, UTC."""
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    cases = {case.name: case for case in suite.cases}
    # One <testsuite> per world, as CI systems fold the cases of a suite.
    worlds: dict[str, list[tuple[Case, Result]]] = {}
    for result in suite.results:
        worlds.setdefault(cases[result.name].world, []).append((cases[result.name], result))
    root = ElementTree.Element("testsuites")
    for number, (world, rows) in enumerate(worlds.items()):
        root.append(_suite(world, rows, number, stamp))
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _suite(world: str, rows: Sequence[tuple[Case, Result]], number: int, stamp: str) -> ElementTree.Element:
    verdicts = [result.verdict for _, result in rows]
    # All attributes that the strictest schema requires, see the head of the module.
    element = ElementTree.Element(
        "testsuite",
        {
            "name": Path(world).stem,
            "package": "mirdrake",
            "id": str(number),
            "timestamp": stamp,
            "hostname": socket.gethostname() or "localhost",
            "tests": str(len(rows)),
            "failures": str(verdicts.count("fail")),
            "errors": str(verdicts.count("error") + verdicts.count("invalid")),
            "time": f"{sum(result.wall for _, result in rows):.3f}",
        },
    )
    properties = ElementTree.SubElement(element, "properties")
    ElementTree.SubElement(properties, "property", {"name": "world", "value": display_path(Path(world))})
    for case, result in rows:
        child = ElementTree.SubElement(
            element,
            "testcase",
            {"name": case.name, "classname": f"{Path(world).stem}.{case.test}", "time": f"{result.wall:.3f}"},
        )
        # JUnit distinguishes a test that failed from one that could not be run.
        if result.verdict != "pass":
            tag = "failure" if result.verdict == "fail" else "error"
            kind = {"fail": "requirement", "error": "error", "invalid": "world"}[result.verdict]
            detail = ElementTree.SubElement(child, tag, {"message": _clean(result.reason), "type": kind})
            detail.text = _clean(_detail(case, result))
    # Readers expect both elements, also if they are empty.
    ElementTree.SubElement(element, "system-out")
    ElementTree.SubElement(element, "system-err")
    return element


def _detail(case: Case, result: Result) -> str:
    lines = [f"{name} = {value}" for name, value in case.values.items()]
    for finding in result.findings:
        margin = "unbounded" if finding.margin is None else f"{finding.margin:.4g} {finding.unit}".strip()
        mark = "holds" if finding.passed else "FAILS"
        lines.append(f"{mark}: {finding.text} (margin {margin} at {finding.worst_time:g} s)")
    lines += [result.reason] if not result.findings else []
    lines.append(f"run again: {case.command}")
    return "\n".join(lines)


def _clean(text: str) -> str:
    """Return a text without characters that XML does not allow."""
    return _NO_XML.sub("?", text)
