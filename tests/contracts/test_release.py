"""A release has one version and one date, wherever they stand; what it declares is what is tested."""

import re
import tomllib
from pathlib import Path

import yaml

import aoabench

ROOT = Path(__file__).parents[2]
# the releases of the changelog: what is not released yet has no number
RELEASES = re.findall(
    r"^## (\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)$",
    (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)


def test_one_version_and_one_date():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    version, date = RELEASES[0]
    stated = {project["version"], citation["version"], aoabench.__version__}
    assert stated == {version}
    assert str(citation["date-released"]) == date


def test_every_section_of_the_changelog_is_a_release_newest_first():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heads = [h for h in re.findall(r"^## (.*)$", text, re.MULTILINE) if h != "Unreleased"]
    assert heads == [f"{version} ({date})" for version, date in RELEASES]
    numbers = [tuple(map(int, version.split("."))) for version, _ in RELEASES]
    assert numbers == sorted(numbers, reverse=True)
    assert [date for _, date in RELEASES] == sorted((d for _, d in RELEASES), reverse=True)


def test_the_declared_pythons_are_those_that_are_tested():
    """The classifiers, the oldest Python, and the versions that `nox` knows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    prefix = "Programming Language :: Python :: 3."
    minors = [int(c[len(prefix) :]) for c in project["classifiers"] if c.startswith(prefix)]
    assert project["requires-python"] == f">=3.{min(minors)}"
    text = (ROOT / ".ci" / "noxfile.py").read_text(encoding="utf-8")
    (listed,) = re.findall(r"^PYTHONS = \[(.*)\]$", text, re.MULTILINE)
    assert listed == ", ".join(f'"3.{minor}"' for minor in minors)


def test_each_dependency_is_declared_once_and_with_its_oldest_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.split(r"[<>=\[]", line)[0] for line in project["dependencies"]]
    assert len(names) == len(set(names))
    lock = (ROOT / ".ci" / "lowest.lock").read_text(encoding="utf-8")
    locked = dict(re.findall(r"^([\w.-]+)==(\S+)", lock, re.MULTILINE))
    for line in project["dependencies"]:
        name, oldest = re.match(r"([\w-]+)>=([\d.]+)", line).groups()
        assert numbers(locked[name]) == numbers(oldest), line
    assert "http" not in lock


def numbers(version):
    """The numbers of a version, without zeros at the end: (2,) for 2.0.0."""
    found = [int(n) for n in version.split(".")]
    while found[-1] == 0:
        found.pop()
    return tuple(found)


def test_the_tests_of_the_oldest_libraries_exist():
    for name in (ROOT / ".ci" / "lowest.tests").read_text(encoding="utf-8").split():
        file, _, test = name.partition("::")
        assert not test or f"def {test.partition('[')[0]}(" in (ROOT / file).read_text(
            encoding="utf-8"
        ), name
