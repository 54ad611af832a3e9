# SPDX-License-Identifier: Apache-2.0
"""A worker without a map, which does what the photo's bytes say."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from gscpe.batch.in_process import Talk
from gscpe.errors import PhotoError, RenderError
from gscpe.service.desk import DECODING, WORKING, LocalizeJob
from gscpe.service.problem import problem_of


def job(says: str, name: str = "a.jpg") -> LocalizeJob:
    return LocalizeJob("fake", says.encode(), name, None, None)


class FakeDesk:
    """Started by :meth:`start`, as :class:`gscpe.service.desk.Desk`."""

    description = "nothing"

    @classmethod
    def start(cls) -> FakeDesk:
        return cls()

    def work(self, job: Any, talk: Talk) -> Any:
        what, _, rest = job.photo.decode().partition(" ")
        talk.tell(DECODING)
        if what == "slow-decode":
            time.sleep(100)
        talk.tell(WORKING)
        return getattr(self, what)(rest, talk)

    def echo(self, text: str, talk: Talk) -> dict[str, Any]:
        return {"status": "localized", "text": text, "pid": os.getpid()}

    def refuse(self, text: str, talk: Talk) -> Any:
        return problem_of(PhotoError(text))

    def die(self, flag: str, talk: Talk) -> dict[str, Any]:
        """Once, where there is a flag: a file that it leaves."""
        if flag and Path(flag).exists():
            return self.echo("again", talk)
        if flag:
            Path(flag).touch()
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError

    def hang(self, flag: str, talk: Talk) -> dict[str, Any]:
        if flag and Path(flag).exists():
            return self.echo("again", talk)
        if flag:
            Path(flag).touch()
        time.sleep(1000)
        raise AssertionError

    def wait(self, flag: str, talk: Talk) -> dict[str, Any]:
        """Until there is a flag, or it is called off."""
        Path(flag + ".begun").touch()
        while not Path(flag).exists():
            try:
                talk.stop_if_told()
            except BaseException:
                Path(flag + ".stopped").touch()
                raise
            time.sleep(0.01)
        return self.echo("waited", talk)

    def toil(self, seconds: str, talk: Talk) -> dict[str, Any]:
        """So long, with a sign of life now and then."""
        end = time.monotonic() + float(seconds)
        while time.monotonic() < end:
            time.sleep(0.05)
            talk.tell(WORKING)
        return self.echo("done", talk)

    def fail(self, text: str, talk: Talk) -> Any:
        raise RenderError(text)

    def close(self) -> None:
        pass


class Stillborn(FakeDesk):
    """Never starts."""

    @classmethod
    def start(cls) -> FakeDesk:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError
