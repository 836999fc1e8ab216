"""`aoabench run` as a command of its own that tests watch, interrupt and kill.

Each is forked from one process that has imported everything: a second and a half of CPU less than a
new interpreter.
"""

import multiprocessing
import os
import signal
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import psutil

from aoabench.cli.main import main

PATIENCE_S = 300  # until a test gives up; a machine under heavy load takes some seconds


def _command(words, said):
    """`aoabench run` in a process and process group of its own, which says things to a file."""
    os.setsid()
    for stream, target in ((1, os.devnull), (2, said)):
        os.dup2(os.open(target, os.O_WRONLY | os.O_CREAT), stream)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ["PYTHONWARNINGS"] = (
        "ignore"  # of what the short end below leaves to the resource tracker
    )
    try:
        main(["run", *words])
    except SystemExit as end:
        sys.stderr.flush()
        os._exit(
            end.code
            # past multiprocessing's own end, which waits for threads that only an interpreter's end
            # ends
        )


_forks = multiprocessing.get_context("forkserver")
_forks.set_forkserver_preload(["aoabench.cli.main", "aoabench.config.compose", "aoabench.engine.runner", "aoabench.kernels.particle",
                               "aoabench.kernels.kalman", "hydra", "pandas", "pyarrow.parquet", "joblib", "rich.progress",
                               "tests.commands"])  # fmt: skip


class Command:
    """A running `aoabench run`."""

    def __init__(self, *words):
        self.said = Path(tempfile.mkstemp()[1])
        self.process = _forks.Process(target=_command, args=(words, str(self.said)))
        self.process.start()
        self.pid = self.process.pid

    def running(self):
        return self.process.is_alive()

    def finished(self):
        """Exit status and what was said, which is never a traceback."""
        self.process.join(PATIENCE_S)
        said = self.said.read_text()
        self.said.unlink()
        assert "Traceback" not in said, said
        return self.process.exitcode, said

    def workers(self):
        """Its worker processes that run."""
        with suppress(psutil.NoSuchProcess):
            children = psutil.Process(self.pid).children(recursive=True)
            return [child for child in children if "popen_loky" in " ".join(child.cmdline())]
        return []
