"""Unique names that URDF, xacro and Drake accept."""

import re


class Names:
    """Names of the links and joints of a car under construction."""

    def __init__(self) -> None:
        self._links: set[str] = {"world"}
        self._joints: set[str] = set()
        self._of: dict[tuple[str, str], str] = {}

    def link(self, source: str) -> str:
        """Return the name of a link of the source."""
        return self._kept("link", source, self._links)

    def joint(self, source: str) -> str:
        """Return the name of a joint of the source."""
        return self._kept("joint", source, self._joints)

    def new(self, wanted: str) -> str:
        """Return a new name for a link."""
        return self.unique(wanted, self._links)

    def new_joint(self, wanted: str) -> str:
        """Return a new name for a joint."""
        return self.unique(wanted, self._joints)

    def _kept(self, kind: str, source: str, taken: set[str]) -> str:
        key = (kind, source)
        if key not in self._of:
            self._of[key] = self.unique(source, taken)
        return self._of[key]

    @staticmethod
    def unique(wanted: str, taken: set[str]) -> str:
        """Return a name of letters, digits and ``_.-`` that is not used yet, and mark it as used.

        Drake splits names at ``::``, and ``$`` and braces have a meaning in xacro.
        """
        plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", wanted) or "part"
        name, number = plain, 1
        while name in taken:
            number += 1
            name = f"{plain}_{number}"
        taken.add(name)
        return name
