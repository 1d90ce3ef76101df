"""Interface of a kind of loop, and of the test bench that it builds."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Protocol

from mirdrake.core.pid import PidLimits
from mirdrake.tuning.designs import Design, OmittedDesign, make_designs
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, LoopSpec
from mirdrake.tuning.search_range import Range
from mirdrake.tuning.spec import TuningSpec

if TYPE_CHECKING:
    from mirdrake.tuning.identify import Identification


class Bench(Protocol):
    """A built loop on which gains are tested."""

    spec: LoopSpec

    @property
    def limits(self) -> PidLimits:
        """Limits of the effort."""
        ...

    def identify(self) -> "Identification":
        """Return the loop with its model."""
        ...

    def run(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, *, margins: Mapping[str, float]
    ) -> Evaluation:
        """Run the test manoeuvre with gains; `margins` are added to the figures."""
        ...


class LoopKind(ABC):
    """A kind of loop. A new one is a class in a file of its own and a line in the registry.

    Attributes:
        name: value of ``loop:`` in a tuning file, and of :attr:`LoopSpec.kind`.
        selectable: whether a tuning file can name it.
        identifiable: whether experiments give a model; without one, gains are searched on the plant only.
        in_control_yaml: whether the gains are entries of control.yaml.
        has_reduced_test: whether the reduced model can make the test; otherwise the first search is on the plant.
        has_own_plant: whether the study's `plant` has the step of the plant, and not a diagram of the user's.
        conditions: conditions that the Monte Carlo draws, besides mass, friction and noise.
        uses_traction: whether the test asks the driven tyres for longitudinal force.
        ranges: of gains that no rule gives a value for.
    """

    name: ClassVar[str]
    selectable: ClassVar[bool] = True
    identifiable: ClassVar[bool] = True
    in_control_yaml: ClassVar[bool] = True
    has_reduced_test: ClassVar[bool] = True
    has_own_plant: ClassVar[bool] = True
    conditions: ClassVar[tuple[str, ...]] = ("delay", "grade", "step")
    uses_traction: ClassVar[bool] = False
    ranges: ClassVar[Mapping[str, Range]] = {}

    @abstractmethod
    def make_spec(self, study: TuningSpec, *, noise: bool | None = None, speed: float | None = None) -> LoopSpec:
        """Return the loop of a study as plain data; see :func:`mirdrake.tuning.loops.registry.make_loop_spec`."""

    def delays(self, study: TuningSpec) -> tuple[float, float]:
        """Return the smallest and the largest delay of the actuator in the Monte Carlo [s]."""
        return study.delays

    def designs(
        self, identification: "Identification", max_sensitivity: float
    ) -> tuple[tuple[Design, ...], tuple[OmittedDesign, ...]]:
        """Return the designs by rules, and those that have no solution; `max_sensitivity`: bound on Ms."""
        return make_designs(identification, max_sensitivity=max_sensitivity)

    def at_own_slopes(self, loop: LoopSpec) -> LoopSpec | None:  # noqa: ARG002
        """Return a loop whose test has the vehicle's own slopes of the set-point; None: the set-point has none."""
        return None

    def at_slopes(self, loop: LoopSpec, rise: float, fall: float) -> LoopSpec:  # noqa: ARG002
        """Return a loop whose test is from a low speed up and back with slopes of the set-point [m/s²].

        A kind whose set-point has no slopes returns the loop.
        """
        return loop

    def followed_slopes(self, loop: LoopSpec, gains: Mapping[str, float]) -> dict[str, float]:  # noqa: ARG002
        """Return the largest slopes that gains follow on the slip model, of those that they do not follow."""
        return {}

    @abstractmethod
    def make_bench(self, spec: LoopSpec) -> Bench:
        """Build the test bench of a loop."""
