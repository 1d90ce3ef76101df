"""Import of user code, which is named ``module:name``."""

import importlib
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import Any

from mirdrake.core.errors import ConfigError, closest, did_you_mean
from mirdrake.core.yaml_io import display_path

__all__ = ["import_user_module", "load_user_function", "without_user_code"]

_FOREIGN: set[str] = set()  # user modules that were imported by this module
_SKIPPED: ContextVar[list[str] | None] = ContextVar("skipped", default=None)


@contextmanager
def without_user_code() -> Iterator[list[str]]:
    """Do not import user modules within the block; yield the names of those that are skipped.

    A user function is replaced by one that raises an error when it is called; a user system is a
    :class:`ConfigError`.
    """
    skipped: list[str] = []
    token = _SKIPPED.set(skipped)
    try:
        yield skipped
    finally:
        _SKIPPED.reset(token)


def import_user_module(name: str, *, folder: str | Path | None = None) -> ModuleType:
    """Import a user module.

    Args:
        name: dotted name of the module.
        folder: searched besides the working directory and the import path.

    Raises:
        ConfigError: the module does not exist, or fails on import.
    """
    skipped = _SKIPPED.get()
    if skipped is not None:
        skipped.append(name)
        raise ConfigError(f"module '{name}' is executed only with --trust")
    # Before the import path: a user's module beside its file has priority over an installed one of that name.
    folders = [Path(path) for path in (folder, Path.cwd()) if path is not None]
    extra = [str(path) for path in folders if str(path) not in sys.path]
    sys.path[:0] = extra
    # Two folders may each have a module of the same name; Python would return the first one again.
    _forget_namesake(name, folders)
    try:
        module = importlib.import_module(name)
        _FOREIGN.add(name)
    except ImportError as error:
        hint = _not_found(name, folders) if error.name in {name, name.partition(".")[0]} else ""
        raise ConfigError(f"module '{name}' cannot be imported: {error}{hint}") from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also SystemExit and GeneratorExit
        raise ConfigError(f"module '{name}' fails on import: {type(error).__name__}: {error}") from None
    finally:
        # Only for the import, so that later imports of the program are not affected.
        for path in extra:
            sys.path.remove(path)
    return module


def skipped_modules() -> Sequence[str]:
    """Return the modules that were skipped so far within :func:`without_user_code`; none outside of it."""
    return tuple(_SKIPPED.get() or ())


def load_user_function(name: str, *, folder: str | Path | None = None) -> Callable[..., Any]:
    """Load a user function.

    Args:
        name: ``module:name``.
        folder: searched for the module besides the working directory and the import path.

    Raises:
        ConfigError: the module or the function does not exist.
    """
    skipped = _SKIPPED.get()
    if skipped is not None:
        skipped.append(name)
        return _not_executed
    module_name, _, function_name = name.partition(":")
    module = import_user_module(module_name, folder=folder)
    function = getattr(module, function_name, None)
    if not callable(function):
        known = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise ConfigError(f"no function '{function_name}' in {module_name}; {did_you_mean(function_name, known)}")
    return function  # type: ignore[no-any-return]


def _not_found(name: str, folders: list[Path]) -> str:
    """Return the tail of the error of a module that does not exist: the most similar one, and where it was searched."""
    near = closest(name, sorted({file.stem for folder in folders for file in folder.glob("*.py")}))
    places = ", ".join(dict.fromkeys(map(display_path, folders)))
    hint = f"; did you mean '{near}'?" if near else ""
    return f"{hint} (searched: {places}, and the import path of Python)"


def _not_executed(*_: Any, **__: Any) -> Any:
    """Replace a user function that was not loaded."""
    raise ConfigError("user functions are executed only with --trust")


def _forget_namesake(name: str, folders: list[Path]) -> None:
    """Unload a module of this name that was imported for a file in another folder."""
    file = getattr(sys.modules.get(name), "__file__", None)
    wanted = [path for folder in folders if (path := folder / f"{name.replace('.', '/')}.py").is_file()]
    # Only modules that were imported here: a module of the program itself must never be unloaded.
    if name in _FOREIGN and file and wanted and not Path(file).samefile(wanted[0]):
        del sys.modules[name]
        importlib.invalidate_caches()
