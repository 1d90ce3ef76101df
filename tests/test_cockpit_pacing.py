"""The pace of a drive on a clock set by the tests: delays are caught up, pictures do not block the drive."""

import pytest

from mirdrake.viewer.cockpit.pace import BEHIND, FRAME, LATE, SHARE, Pace

PERIOD = 1.0 / 64.0


class Clock:
    """A clock that advances with simulated work and sleep."""

    def __init__(self, *, oversleeps: float = 0.0) -> None:
        self.now, self.slept, self._oversleeps = 100.0, 0.0, oversleeps

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.slept += seconds
        self.now += seconds + self._oversleeps


def drive(clock: Clock, *, wall: float, slice_costs: float, picture_costs: float = 0.0) -> tuple[float, list[float]]:
    """Simulated time over wall-clock time, and when pictures were begun."""
    pace, slices, pictures, began = Pace(PERIOD, clock=clock, sleep=clock.sleep), 0, [], clock()
    while clock() < began + wall:
        clock.work(slice_costs)
        slices += 1
        pace.keep()
        if pace.draws():
            pictures.append(clock())
            clock.work(picture_costs)
            pace.drew()
    return slices * PERIOD / (clock() - began), pictures


def test_a_drive_with_time_to_spare_keeps_exactly_to_the_wall_clock_and_draws_at_full_rate():
    clock = Clock()
    factor, pictures = drive(clock, wall=10.0, slice_costs=0.003, picture_costs=0.002)
    assert factor == pytest.approx(1.0, abs=PERIOD / 10.0)
    assert len(pictures) == pytest.approx(10.0 / (2.0 * PERIOD), abs=2)  # every second slice
    assert clock.slept == pytest.approx(10.0 - 640 * 0.003 - 320 * 0.002, abs=0.05)  # all that is left


def test_an_overlong_sleep_is_caught_up():
    factor, _ = drive(Clock(oversleeps=0.012), wall=10.0, slice_costs=0.003, picture_costs=0.002)
    assert factor == pytest.approx(1.0, abs=0.003)


@pytest.mark.parametrize(("stall", "lost"), [(0.3, 0.0), (0.9, 0.4), (5.0, 4.5)])
def test_a_stall_is_caught_up_to_a_limit(stall, lost):
    clock = Clock()
    pace, slices, began = Pace(PERIOD, clock=clock, sleep=clock.sleep), 0, clock()
    for tick in range(640):
        clock.work(stall if tick == 100 else 0.003)
        slices += 1
        pace.keep()
    assert clock() - began - slices * PERIOD == pytest.approx(lost, abs=2.0 * PERIOD)
    assert BEHIND == 0.5


@pytest.mark.parametrize("cost", [0.03, 0.1, 0.5])
def test_slow_pictures_get_rarer_and_do_not_slow_the_drive(cost):
    factor, pictures = drive(Clock(), wall=20.0, slice_costs=0.005, picture_costs=cost)
    assert factor == pytest.approx(1.0, abs=0.03)
    assert len(pictures) * cost < 1.1 * SHARE * 20.0
    assert len(pictures) >= 20.0 / (5.0 * max(FRAME, cost / SHARE)) - 1  # but they never end


def test_a_machine_that_is_too_slow_gives_pictures_a_twentieth_and_the_drive_the_rest():
    factor, pictures = drive(Clock(), wall=20.0, slice_costs=2.0 * PERIOD, picture_costs=0.03)
    assert factor == pytest.approx(0.5 * (1.0 - SHARE / 5.0), abs=0.02)
    assert len(pictures) * 0.03 / 20.0 == pytest.approx(SHARE / 5.0, abs=0.01)


def test_a_pause_is_not_caught_up():
    clock = Clock()
    pace = Pace(PERIOD, clock=clock, sleep=clock.sleep)
    clock.work(0.4)
    pace.rest()
    pace.keep()
    assert clock.slept == pytest.approx(PERIOD)
    assert pace.late < LATE
