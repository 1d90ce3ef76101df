"""Meaning of error texts of Drake, which raises RuntimeError for all errors, so that only their texts differ.

This is the only module that reads such texts; its test holds them as Drake 1.51 and 1.58 write them.
"""

import re

_DIVERGENCE = re.compile(
    r"converge|\bnan\b|\binf\b|not finite|non-?finite|infinit|singular|factori[sz]|unstable", re.IGNORECASE
)
_LINE_OF_URDF = re.compile(r"<literal-string>\.urdf:(\d+):\s*")
_PORT_OF_LOOP = re.compile(r"putPort\[\d+\] \((.*?)\) of System (?:\S*::)?(\S+) \(")


def is_divergence(text: str) -> bool:
    """Return whether an error means that a state or a force has become too large to continue, or is not a number."""
    return _DIVERGENCE.search(text) is not None


def is_solver_failure(text: str) -> bool:
    """Return whether an error means that the contact solver has not converged."""
    return "converge" in text


def is_meshcat_crash(text: str) -> bool:
    """Return whether an error means that Meshcat's own thread has ended."""
    return "websocket thread" in text


def algebraic_loop(text: str) -> list[str] | None:
    """Return the ports of an algebraic loop as ``system.port``; None if an error means something else."""
    if "algebraic loop" not in text:
        return None
    return [f"{system}.{port}" for port, system in _PORT_OF_LOOP.findall(text)]


def urdf_fault(text: str) -> tuple[int, str]:
    """Return line and reason of an error or a warning about a URDF text that Drake parsed; line 0 without one."""
    match = _LINE_OF_URDF.search(text)
    reason = re.sub(r"^(warning|error):\s*", "", _LINE_OF_URDF.sub("", text))
    return int(match.group(1)) if match else 0, " ".join(reason.split())


def mesh_fault(text: str) -> str:
    """Return the reason of an error about a mesh that Drake cannot read, without the names of the readers."""
    return " ".join(text.split()).rpartition(": ")[2][:200]


def first_sentence(text: str) -> str:
    """Return the first sentence of an error; some of Drake's explain for a page what may cause them."""
    return text.strip().split(". ")[0].splitlines()[0]
