"""The pages for contributors name what there is."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import tomllib

import house
import pytest
from places import ROOT

import mdm

PAGES = ["CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "README.md"]

if not (ROOT / "CONTRIBUTING.md").is_file():
    pytest.skip("the pages are beside the sources alone", allow_module_level=True)


@pytest.mark.parametrize("page", PAGES)
def test_targets_files_and_links_exist(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    targets = set(re.findall(r"^([\w-]+(?: [\w-]+)*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    targets = {word for names in targets for word in names.split()}
    for words in re.findall(r"`make ([a-z -]+)`", text):
        assert set(words.split()) <= targets
    for path in re.findall(r"`((?:mdm|tests|docs|benchmarks|examples|\.ci)/[\w./-]*)`", text):
        assert (ROOT / path).exists() or "NAME" in path, path
    for link in re.findall(r"\]\(([\w./-]+)(?:#[\w-]+)?\)", text):
        assert (ROOT / link).exists(), link


def test_the_workflow_and_the_hooks_are_read():
    yaml = pytest.importorskip("yaml")
    workflow = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8"))
    assert workflow["jobs"]["linux"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    assert {hook["entry"].split()[0].removeprefix(".venv/bin/") for hook in hooks[0]["hooks"]} == {
        "ruff",
        "lint-imports",
        "mypy",
    }


def test_the_version_stands_in_one_place():
    found = subprocess.run([sys.executable, "-m", "mdm", "--version"], capture_output=True, text=True, check=True)
    assert found.stdout == f"mdm {mdm.__version__}\n"
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert 'dynamic = ["version"]' in project
    assert mdm.__version__ not in project


def test_the_sources_have_all_that_their_tests_need(tmp_path):
    pytest.importorskip("hatchling")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        names = {name.partition("/")[2] for name in opened.getnames()}
    needed = {"Makefile", "constraints.txt", "benchmarks/startup.py", ".ci/run", "CONTRIBUTING.md", ".gitignore"}
    assert needed <= names
    for folder in ("mdm", "examples", "tests", "docs", "benchmarks"):
        listed = subprocess.run(["git", "ls-files", folder], cwd=ROOT, capture_output=True, text=True)
        if listed.returncode == 0:
            assert set(listed.stdout.splitlines()) <= names


def test_no_row_of_the_house_is_beyond_its_limit():
    limits = tomllib.loads(house.LIMITS.read_text(encoding="utf-8"))
    assert house.excess(house.measured(house.sources()), limits) == []


def test_a_row_that_grows_or_is_new_is_told():
    small = {"actors/life.py": '"""A life, and what it is."""\n\n\nclass Life:\n    """One."""\n'}
    limits = house.measured(small)
    assert house.excess(limits, limits) == []
    assert limits["what"]["actors"] == 142.9
    large = {
        **small,
        "maps/walls.py": "import_module('mdm.views')  # noqa\n",
        "actors/life.py": small["actors/life.py"] + "x = 1\n",
    }
    assert house.excess(house.measured(large), limits) == [
        "lines: 'actors' has 6, and 5 is its limit",
        "lines: 'maps' has 1 and no limit: it is new",
        "files: 'maps' has 1 and no limit: it is new",
        "house: 'lines' has 7, and 5 is its limit",
        "house: 'files' has 2, and 1 is its limit",
        "house: 'docstrings per cent' has 28.6, and 40.0 is its limit",
        "house: 'noqa' has 1, and 0 is its limit",
        "house: 'imports of other packages by string' has 1, and 0 is its limit",
    ]


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("attributes", "".join(f"    a{count}: int = 0\n" for count in range(21))),
        ("attributes", "    def a(self):\n" + "".join(f"        self.a{count} = 0\n" for count in range(21))),
        ("methods", "".join(f"    def a{count}(self): ...\n" for count in range(31))),
    ],
)
def test_classes_with_too_many_members_are_named(kind, body):
    assert list(house.measured({"a.py": f"class A:\n{body}"})[kind]) == ["a.py:A"]
