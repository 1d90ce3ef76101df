"""Result of a learning study, as learning.json in its folder."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from mirdrake.core.errors import ConfigError
from mirdrake.core.files import read_errors, write_file
from mirdrake.core.json_io import Json, parse_json, read_record
from mirdrake.learning.delays import DelayMargin, delay_sentence, is_delay_the_cause
from mirdrake.learning.drives import Drive

RESULT, JOURNAL = "learning.json", "journal.jsonl"


@dataclass(frozen=True)
class RoundResult:
    """A training and the drives of its network.

    Attributes:
        number: 0 for the first training on the expert's runs.
        pictures: number of pictures for training.
        training_loss: of each epoch, in units of the scaled label.
        validation_error: root mean square error of the steering at places that were not learnt, of each epoch [rad].
        file: ONNX file of the network, in the folder.
        sha256: hash of this file.
        drives: drives by world.
    """

    number: int
    pictures: int
    training_loss: tuple[float, ...]
    validation_error: tuple[float, ...]
    file: str
    sha256: str
    drives: Mapping[str, Drive]


@dataclass(frozen=True)
class CloneResult:
    """Result of a learning study.

    Attributes:
        name: name of the study.
        folder: its folder.
        spec: the study as plain data.
        seed: seed of the study.
        versions: versions of the packages.
        vehicle: name of the vehicle in the diagram.
        delay: margins of the steering loop.
        delayed_expert: a lap of the expert whose steering has the delay of the network.
        collected: runs of the expert.
        rounds: trainings, the last one is the result.
        processor_s: processor time of all steps [s].
    """

    name: str
    folder: Path
    spec: Json
    seed: int
    versions: dict[str, str]
    vehicle: str
    delay: DelayMargin
    delayed_expert: Drive
    collected: tuple[Drive, ...]
    rounds: tuple[RoundResult, ...]
    processor_s: float

    @property
    def last(self) -> RoundResult:
        """The last round."""
        return self.rounds[-1]

    @property
    def delay_sentence(self) -> str:
        """What the delay of the loop means, in a few sentences."""
        return delay_sentence(self.delay, self.delayed_expert.figures)

    @property
    def is_delay_the_cause(self) -> bool:
        """Whether the delay alone explains a car that weaves or leaves the road."""
        return is_delay_the_cause(self.delay, self.delayed_expert.figures)

    @property
    def is_driven(self) -> bool:
        """Whether the network of the last round has finished every drive without an intervention."""
        return all(drive.figures.finished and not drive.figures.interventions for drive in self.last.drives.values())


def write_result(result: CloneResult) -> CloneResult:
    """Write the result into its folder, and return it."""
    data = asdict(result)
    data.pop("folder")
    write_file(result.folder / RESULT, json.dumps(data, indent=1) + "\n")
    return result


def read_result(folder: Path) -> CloneResult:
    """Return the result in a folder.

    Raises:
        ConfigError: the folder has none, or it is damaged.
    """
    file = folder / RESULT
    if not file.is_file():
        raise ConfigError(f"not the folder of a finished learning study (it has no {RESULT})", where=str(folder))
    with read_errors(file):
        data = dict(parse_json(file.read_text(encoding="utf-8")))
    return read_record(CloneResult, {**data, "folder": folder}, str(file))
