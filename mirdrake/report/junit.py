"""Results of a suite as JUnit XML, which every continuous integration service reads.

The file keeps to the strictest of the schemas in use, the one that Ant's JUnit task writes (windyroad's JUnit.xsd): a
test suite for every world file, a test case for every variation, `failure` for what failed, `error` for the rest.
"""

import re
import socket
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from mirdrake.core.files import write_file
from mirdrake.core.yaml_io import shown
from mirdrake.suites import Case, Result, Suite

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(suite: Suite, path: Path) -> Path:
    """Write the results of a suite as JUnit XML.

    Args:
        suite: its results, complete or not.
        path: file to write.

    Raises:
        RunError: it cannot be written.
    """
    write_file(path, render_junit(suite))
    return path


def render_junit(suite: Suite, *, now: datetime | None = None) -> str:
    """The text of the file; `now` is the time that it tells, UTC."""
    stamp = (now or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%S")
    cases = {case.name: case for case in suite.cases}
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
    ElementTree.SubElement(properties, "property", {"name": "world", "value": shown(Path(world))})
    for case, result in rows:
        child = ElementTree.SubElement(
            element,
            "testcase",
            {"name": case.name, "classname": f"{Path(world).stem}.{case.test}", "time": f"{result.wall:.3f}"},
        )
        if result.verdict != "pass":
            tag = "failure" if result.verdict == "fail" else "error"
            kind = {"fail": "requirement", "error": "error", "invalid": "world"}[result.verdict]
            detail = ElementTree.SubElement(child, tag, {"message": _clean(result.reason), "type": kind})
            detail.text = _clean(_detail(case, result))
    ElementTree.SubElement(element, "system-out")
    ElementTree.SubElement(element, "system-err")
    return element


def _detail(case: Case, result: Result) -> str:
    lines = [f"{name} = {value}" for name, value in case.values.items()]
    for finding in result.findings:
        margin = "unbounded" if finding["margin"] is None else f"{finding['margin']:.4g} {finding['unit']}".strip()
        mark = "holds" if finding["passed"] else "FAILS"
        lines.append(f"{mark}: {finding['text']} (margin {margin} at {finding['worst_time']:g} s)")
    lines += [result.reason] if not result.findings else []
    lines.append(f"again: {case.command}")
    return "\n".join(lines)


def _clean(text: str) -> str:
    """The text without characters that XML cannot hold."""
    return _NO_XML.sub("?", text)
