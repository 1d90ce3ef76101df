"""Where the .tir files of a vehicle are."""

from pathlib import Path

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.paths import search_folders
from mirdrake.core.yaml_io import where
from mirdrake.vehicles.spec import VehicleSpec
from mirdrake.vehicles.tyre_spec import MagicFormulaTyres


def find_tyre_files(spec: VehicleSpec, folder: Path) -> tuple[Path, ...]:
    """The tyre property files of front and rear axle; none for tyres that have none.

    A name is looked up in the vehicle's folder, then in the folder ``tyres`` beside the vehicles of every ``models``
    folder.

    Args:
        spec: vehicle.yaml.
        folder: of the vehicle.

    Raises:
        ConfigError: there is no such file.
    """
    if not isinstance(spec.tyres, MagicFormulaTyres):
        return ()
    found = []
    for key, name in zip(("file", "rear_file" if spec.tyres.rear_file else "file"), spec.tyres.files(), strict=True):
        folders = [folder, *(models / "tyres" for models in search_folders("models"))]
        path = next((place / name for place in folders if _is_file(place / name)), None)
        if path is None:
            known = [other.name for place in folders for other in sorted(place.glob("*.tir"))]
            raise ConfigError(f"{where(spec, 'tyres', key)}: no file '{name}'; {did_you_mean(name, known)}")
        found.append(path)
    return tuple(found)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, in a folder we may not enter, a zero byte
        return False
