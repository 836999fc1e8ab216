"""The tests on every supported Python and on the oldest libraries, each in its own environment.

nox -f .ci/noxfile.py                             everything, which takes hours
nox -f .ci/noxfile.py -s tests-3.13               the whole suite with the newest libraries
nox -f .ci/noxfile.py -s lowest -- tests/store    some tests with the oldest libraries
"""

from pathlib import Path

import nox

PYTHONS = ["3.11", "3.12", "3.13"]
EXTRAS = "test,dask,xlsx,geo,dxf,xarray"
ROOT = Path(__file__).parents[1]
# what finds a library that is too old soonest: the command line, compiled kernels, statistics,
# tables
LOWEST = (ROOT / ".ci" / "lowest.tests").read_text(encoding="utf-8").split()

nox.options.sessions = ["lint", "tests", "lowest"]
nox.options.default_venv_backend = "uv|virtualenv"


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """The whole suite, or the given tests, with the newest libraries."""
    session.chdir(ROOT)
    session.install("-e", f".[{EXTRAS}]")
    session.run("python", "-m", "pytest", *session.posargs)


@nox.session(python=PYTHONS[0])
def lowest(session: nox.Session) -> None:
    """The tests LOWEST, or the given ones, with the oldest libraries that pyproject.toml allows."""
    session.chdir(ROOT)
    session.install("--require-hashes", "-r", ".ci/lowest.lock")
    session.install("--no-deps", "-e", ".")
    session.run("python", "-m", "pytest", *(session.posargs or LOWEST))


@nox.session(python=PYTHONS[0])
def lint(session: nox.Session) -> None:
    """Linters and types with the versions of requirements.lock."""
    session.chdir(ROOT)
    session.install("--require-hashes", "-r", "requirements.lock")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("mypy")


@nox.session(python=PYTHONS[0])
def docs(session: nox.Session) -> None:
    """The documentation as a site, in results/draft/site."""
    session.chdir(ROOT)
    for lock in ("requirements.lock", ".ci/docs.lock"):
        session.install("--require-hashes", "-r", lock)
    session.install("--no-deps", "-e", ".")
    session.run("mkdocs", "build", "--quiet", "--strict", "-f", ".ci/mkdocs.yml")
