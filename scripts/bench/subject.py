"""One driver under measurement, in a separate process: JSON requests on standard input, JSON replies on output.

    cd scripts; echo '{"do": "start"}' | YAM_RIG=demo python -m bench.subject '{"kind": "ours", "arms": 1}'

Started by `bench.runner`. YAM_RIG names the rig. Requests: start, hog (busy until SIGUSR1), work (get + send at a
rate), stop.
"""

import json
import os
import signal
import sys
import time
from typing import Any

from bench.drivers import KINDS, Driver


class Subject:
    """Executes the benchmark's requests on one driver."""

    def __init__(self, job: dict[str, Any]):
        self._driver: Driver = KINDS[job.pop("kind")](**job)
        self._hogging = False
        signal.signal(signal.SIGUSR1, self._rest)

    def _rest(self, *_: object) -> None:
        self._hogging = False

    def start(self) -> dict[str, Any]:
        """Connect the driver."""
        self._driver.start()
        return {}

    def hog(self) -> dict[str, Any]:
        """Keep the interpreter busy with Python code that never waits, until SIGUSR1."""
        self._hogging = True
        _answer({"hogging": True})
        while self._hogging:
            sum(i * i for i in range(1000))
        return {}

    def work(self, seconds: float, rate_hz: float, ages: bool = True) -> dict[str, Any]:
        """Get and send at a rate. Returns rows of get + send time and sample age when get returned, both in ms."""
        driver, rows = self._driver, []
        deadline = time.monotonic()
        end = deadline + seconds
        while (begin := time.monotonic()) < end:
            got = driver.get()
            between = time.monotonic()
            age_s = driver.age_s(got, between) if ages else 0.0
            resumed = time.monotonic()
            driver.send(got)
            rows.append(((time.monotonic() - resumed + between - begin) * 1e3, age_s * 1e3))
            now = time.monotonic()
            deadline = max(deadline + 1.0 / rate_hz, now)
            if deadline > now:
                time.sleep(deadline - now)
        return {"rows": rows}

    def stop(self) -> dict[str, Any]:
        """Disconnect the driver."""
        self._driver.stop()
        return {}


def _answer(fields: dict[str, Any]) -> None:
    _OUT.write(json.dumps(fields) + "\n")
    _OUT.flush()


def main() -> None:
    """Serve requests until `stop` or until the benchmark closes standard input."""
    subject = Subject(json.loads(sys.argv[1]))
    _answer({"ready": True})
    started = False
    for line in sys.stdin:
        request = json.loads(line)
        do = request.pop("do")
        started |= do == "start"
        try:
            _answer(getattr(subject, do)(**request))
        except Exception as error:
            _answer({"error": f"{type(error).__name__}: {error}"})
        if do == "stop":
            return
    if started:
        subject.stop()


if __name__ == "__main__":
    # Drivers print to standard output; redirect this output so that it does not mix with the replies.
    _OUT = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    main()
