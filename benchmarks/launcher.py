"""Starts processes and weighs them. A process of its own, and a small one: on Linux the peak of memory of a new program
begins with that of the program that started it, so a large one must not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time


def main() -> None:
    """Reads a command as a line of JSON, runs it, and writes what it took; until there are no more."""
    for line in sys.stdin:
        start = time.perf_counter()
        with subprocess.Popen(
            json.loads(line), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as child:
            assert child.stderr is not None
            said = child.stderr.read()
            _, status, usage = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
        taken = [time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024]
        print(json.dumps([*taken, child.returncode, said.decode(errors="replace")]), flush=True)


if __name__ == "__main__":
    main()
