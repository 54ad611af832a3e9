# SPDX-License-Identifier: Apache-2.0
"""Frames ahead of their use, and in real time."""

from __future__ import annotations

import threading
import time
from typing import Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gscpe.errors import SequenceError, SettingsError
from gscpe.geometry import Camera
from gscpe.sequences import Clock, Frame, Frames, InRealTime, ReadAhead

CAMERA = Camera.pinhole(4, 3, fx=4, fy=4, cx=2, cy=1.5)


def frame(seconds: float | None) -> Frame:
    return Frame(f"{seconds}.png", seconds, np.zeros((3, 4, 3), np.uint8), CAMERA)


class Made(Frames):
    """Frames of these times, and then maybe an error."""

    description = "made"

    def __init__(self, times: Sequence[float], error: Exception | None = None) -> None:
        self.times, self.error = times, error
        self.read = 0
        self.goes_on = threading.Event()
        self.goes_on.set()

    def __iter__(self) -> Iterator[Frame]:
        for seconds in self.times:
            self.goes_on.wait(10)
            self.read += 1
            yield frame(seconds)
        if self.error is not None:
            raise self.error


def until(true: object) -> None:
    end = time.monotonic() + 10
    while not true() and time.monotonic() < end:  # type: ignore[operator]
        time.sleep(0.002)
    assert true()  # type: ignore[operator]


def threads() -> list[str]:
    return [thread.name for thread in threading.enumerate()]


def test_frames_are_read_ahead_but_not_all() -> None:
    made = Made(range(50))
    with ReadAhead(made, depth=3) as ahead:
        until(lambda: made.read == 4)  # three that wait, and one in hand
        time.sleep(0.02)
        assert made.read == 4
        assert [f.time for f in ahead] == list(range(50))
        assert ahead.dropped == 0
    assert "gscpe frames" not in threads()


def test_it_can_be_closed_in_the_middle() -> None:
    made = Made(range(50))
    ahead = ReadAhead(made, depth=2)
    assert next(iter(ahead)).time == 0
    ahead.close()
    assert "gscpe frames" not in threads()
    assert made.read < 6


def test_errors_come_after_the_frames_before_them() -> None:
    with ReadAhead(Made([0, 1], SequenceError("it ends here"))) as ahead:
        assert [next(ahead).time, next(ahead).time] == [0, 1]
        with pytest.raises(SequenceError, match="it ends here"):
            next(ahead)
        with pytest.raises(StopIteration):
            next(ahead)


def test_of_a_live_source_only_the_newest_counts() -> None:
    made = Made(range(5))
    made.live = True
    with ReadAhead(made) as ahead:
        until(lambda: ahead._ended)
        assert [f.time for f in ahead] == [4]
        assert ahead.dropped == 4


class FakeClock(Clock):
    """Time that passes where somebody waits, or works."""

    def __init__(self) -> None:
        self.seconds = 100.0

    def now(self) -> float:
        return self.seconds

    def wait(self, seconds: float) -> None:
        assert seconds > 0
        self.seconds += seconds


def worked_on(times: Sequence[float], work: float | Sequence[float]) -> tuple[list[float], int]:
    """Moments of the frames that are worked on, and how many are dropped, where a frame takes so
    long."""
    clock = FakeClock()
    paced = InRealTime(iter([frame(t) for t in times]), clock)
    seen = []
    for number, each in enumerate(paced):
        assert each.time is not None
        assert clock.now() - 100.0 >= each.time - times[0] - 1e-9, "not before its time"
        seen.append(each.time)
        clock.seconds += work if isinstance(work, float) else work[number % len(work)]
    return seen, paced.dropped


def test_frames_that_come_slower_than_the_work_are_all_taken() -> None:
    times = [5.0, 5.1, 5.2, 5.3]
    assert worked_on(times, 0.09) == (times, 0)


def test_frames_that_come_while_the_tracker_is_busy_are_dropped() -> None:
    """The newest one that has come is taken, and then the next one is awaited."""
    assert worked_on([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [2.5, 0.1]) == ([0, 2, 3, 5, 6], 2)
    assert worked_on([0.0, 1.0, 2.0, 3.0], 9.0) == ([0, 3], 2)


@given(
    st.lists(st.floats(0.01, 1.0), min_size=1, max_size=30),
    st.lists(st.floats(0.0, 2.0), min_size=1, max_size=5),
)
def test_no_frame_is_lost_without_being_counted(steps: list[float], work: list[float]) -> None:
    times = list(np.cumsum(steps))
    seen, dropped = worked_on(times, work)
    assert len(seen) + dropped == len(times)
    assert seen == sorted(set(seen))
    assert seen[0] == times[0] and seen[-1] == times[-1]


def test_no_times_no_real_time() -> None:
    with pytest.raises(SettingsError, match=r"None\.png has no time.*--rate"):
        next(iter(InRealTime(iter([frame(None)]))))
    assert list(InRealTime(iter([]))) == []
