"""Changes to files of a vehicle folder: shown as a difference, then written atomically."""

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mirdrake.core.errors import ConfigError, RunError
from mirdrake.core.files import write_errors, write_file
from mirdrake.core.paths import resolved
from mirdrake.core.yaml_edit import Edit, edit_yaml
from mirdrake.core.yaml_io import display_path, read_text


@dataclass(frozen=True)
class FileChange:
    """A file before and after.

    Attributes:
        path: the file.
        before: its text, line ends as they are.
        after: the text that it shall have.
        notes: notes for the user, one line each.
    """

    path: Path
    before: str
    after: str
    notes: tuple[str, ...] = ()

    @property
    def changes(self) -> bool:
        """Whether there is anything to write."""
        return self.before != self.after

    def diff(self) -> str:
        """Return the difference in unified form; empty if there is none."""
        name = display_path(self.path)
        lines = difflib.unified_diff(
            self.before.splitlines(keepends=True), self.after.splitlines(keepends=True), name, name, "before", "after"
        )
        return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)

    def write(self) -> None:
        """Write the file atomically, with its mode; a link remains a link.

        Raises:
            RunError: the file cannot be written, or has changed since it was read.
        """
        if not self.changes:
            return
        path = resolved(self.path)
        with write_errors(path):
            # The user may have edited the file since it was read.
            if path.read_bytes() != self.before.encode():
                raise RunError("has changed in the meantime; run it again", where=display_path(self.path))
            mode = path.stat().st_mode
        write_file(path, self.after)
        path.chmod(mode & 0o7777)


def change_file(
    path: Path, edits: Sequence[Edit], *, check: Callable[[str], None], notes: Sequence[str] = ()
) -> FileChange:
    """Return the change of a YAML file by edits; the file is not written.

    Args:
        path: the file.
        edits: values to set; nothing is changed if all are there already.
        check: raises ConfigError if a text would no longer load.
        notes: notes to go with the change.

    Raises:
        ConfigError: the file cannot be read, an edit does not fit it, or it would no longer load.
    """
    read_text(path)  # raises errors in the project's form
    # Bytes, as reading as text would change the line ends.
    before = path.read_bytes().decode()
    name = display_path(path)
    try:
        check(before)
    except ConfigError as error:
        raise ConfigError(f"{error}\n{name}: is left unchanged; fix it first") from None
    # Without comments of the edits: values that are there already change nothing, not even a comment.
    bare = [Edit(edit.path, edit.value) for edit in edits]
    if edit_yaml(before, bare, name=name) == before:
        return FileChange(path, before, before, tuple(notes))
    after = edit_yaml(before, edits, name=name)
    try:
        check(after)
    except ConfigError as error:
        raise ConfigError(f"{error}\n{name}: is left unchanged; it would not load with these values") from None
    return FileChange(path, before, after, tuple(notes))
