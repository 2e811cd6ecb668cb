"""The pages of the reference, against the code, both ways."""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import inspect
import re
from pathlib import Path

import msgspec
import pytest
from places import ROOT

import mdm
from mdm.cli import VERBS
from mdm.config.tables import Table

DOCS = ROOT / "docs"
PACKAGE = Path(mdm.__file__).parent
NAMES = ROOT / "tests" / "public_names.txt"


@pytest.fixture(scope="module")
def generated():
    """The module that makes the pages."""
    spec = importlib.util.spec_from_file_location("generated", DOCS / "generated.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def pages(generated):
    return generated.pages()


def sources():
    """Yield every module of the package, parsed."""
    for path in PACKAGE.rglob("*.py"):
        yield path, ast.parse(path.read_text(encoding="utf-8"))


def test_every_public_name_is_documented(generated, pages):
    for package in generated.PACKAGES:
        module = importlib.import_module(package)
        page = pages[f"names-{package}.md"]
        assert re.findall(r"^## `(\w+)`$", page, re.MULTILINE) == sorted(module.__all__, key=str.lower)
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isclass(thing) or inspect.isroutine(thing):
                assert thing.__doc__.split("\n")[0].split("``")[0].split("`")[0] in page


def test_each_example_is_one_block_of_code(generated):
    """Names and indents of an example that an empty pair of lines divides were read as prose."""
    page = generated.names("mdm.policies")
    assert "    def action(self, state):\n        return state % 2\n\n\nmdm.Controller(Parity())" in page
    outside = "".join(page.split("```")[::2])
    assert "mdm.Controller(" not in outside


def test_every_package_with_public_names_has_its_page(generated):
    listed = {
        ".".join(("mdm", *path.parent.relative_to(PACKAGE).parts))
        for path, tree in sources()
        if path.name == "__init__.py"
        and any(
            isinstance(node, ast.Assign) and node.targets[0].id == "__all__"
            for node in tree.body
            if hasattr(node, "targets") and isinstance(node.targets[0], ast.Name)
        )
    }
    own = {name for name in listed if not name.startswith(("mdm.cli", "mdm.views")) and name.count(".") < 2}
    assert own <= set(generated.PACKAGES)


def test_every_key_of_the_file_has_a_type_and_a_meaning(generated):
    structs = set()
    for path, others in generated.TABLES.values():
        struct = generated.find(path)
        structs.add(struct)
        assert not [key for key, (kind, _, meaning) in generated.keys(struct, others).items() if not (kind and meaning)]
    importlib.import_module("mdm.config.communication")
    assert structs == {each for each in Table.__subclasses__() if each.__module__.startswith("mdm.config")}


def test_every_key_is_on_the_page_of_the_file(generated):
    page = (DOCS / "configuration.md").read_text(encoding="utf-8") + (DOCS / "teams.md").read_text(encoding="utf-8")
    for path, _ in generated.TABLES.values():
        fields = msgspec.structs.fields(generated.find(path))
        assert [each.name for each in fields if not re.search(rf"\b{each.name}\b", page)] == [], path


def test_every_command_and_option_is_there(generated, pages):
    page = pages["commands.md"]
    commands = re.findall(r"^## `(mdm.*)`$", page, re.MULTILINE)
    assert [words.split()[1] for words in commands if words.count(" ") == 1] == list(VERBS)
    for _, parser in generated.parsers(generated.make_parser(), "mdm"):
        for action in parser._actions:
            if action.help is not argparse.SUPPRESS:
                assert all(name in page for name in action.option_strings)


def test_every_kind_of_fault_has_its_entry():
    """A kind is a word among the first arguments of what reports."""
    reporting = re.compile("report|Fault|_alarm|_lose|refuse|drop|call_soon")
    found = set()
    for path, tree in sources():
        if path.is_relative_to(PACKAGE / "cli") or path.is_relative_to(PACKAGE / "formats"):
            continue
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            if reporting.search(name):
                words = [
                    part
                    for each in call.args[:3]
                    for part in ([each.body, each.orelse] if isinstance(each, ast.IfExp) else [each])
                ]
                found |= {
                    each.value
                    for each in words
                    if isinstance(each, ast.Constant)
                    and isinstance(each.value, str)
                    and re.fullmatch("[a-z_]+", each.value)
                }
    elsewhere = {
        "majority",  # told as lost_majority
        "runtime",  # the source of the runtime's faults
        "too_early",
        "too_late",
        "contradictory",
        "external_belief",
        "initial_belief",  # reasons, within a sentence
        "malformed",
        "renumbered",
    }
    from mdm.faults import KINDS

    assert found - set(KINDS) <= elsewhere
    assert set(KINDS) <= found | {"malformed", "renumbered", "missing"}


def test_every_statistic_is_there(generated, pages):
    structs = {
        node.name
        for _, tree in sources()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and node.name.endswith("Statistics") and not node.name.startswith("_")
    }
    assert {path.rsplit(".", 1)[1] for path in generated.STATISTICS} == structs
    for path in generated.STATISTICS:
        struct = generated.find(path)
        part = pages["statistics.md"].split(f"## `{struct.__name__}`")[1].split("\n## ")[0]
        assert re.findall(r"^\| `(\w+)` \| .+ \|", part, re.MULTILINE) == list(struct.__struct_fields__)
        assert struct.__doc__.split("\n")[0].split("`")[0] in part


def channels():
    """Return the channels that the code makes: the last part of each name, the type, and whether it is retained."""
    found = set()
    for path, tree in sources():
        if path.is_relative_to(PACKAGE / "team" / "sharing"):
            continue  # those of other agents, by the same names
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            if getattr(call.func, "attr", getattr(call.func, "id", "")) != "channel" or len(call.args) != 2:
                continue
            name, kind = call.args
            part = name.values[-1] if isinstance(name, ast.JoinedStr) else name
            if isinstance(part, ast.IfExp) and isinstance(part.body, ast.Constant):
                names = [part.body.value, part.orelse.value]
            elif isinstance(part, ast.Constant):
                names = [part.value.rsplit("/", 1)[-1]]
            else:
                continue
            retained = any(keyword.arg == "retain" for keyword in call.keywords)
            found |= {(each, ast.unparse(kind), retained) for each in names}
    return found


def test_every_channel_is_there_with_its_type():
    page = (DOCS / "reference" / "channels.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (yes|no) \|", page, re.MULTILINE)
    told = {(name, kind, retained == "yes") for name, kind, retained in rows}
    made = {(name, kind, retained) for name, kind, retained in channels() if kind != "type"}
    assert {(name, kind) for name, kind, _ in told} == {(name, kind) for name, kind, _ in made}
    assert {(name, kind) for name, kind, retained in made if retained} == {
        (name, kind) for name, kind, retained in told if retained
    }


def test_every_message_is_on_a_channel():
    page = (DOCS / "reference" / "channels.md").read_text(encoding="utf-8")
    on_none = {"Message", "Cause", "ModeName"}  # a base, a part of a mode, its names
    assert [name for name in mdm.messages.__all__ if f"`{name}`" not in page and name not in on_none] == []


def public_names(generated):
    """Return every public name with its signature, a line each."""
    lines = []
    for package in generated.PACKAGES:
        module = importlib.import_module(package)
        for name in sorted(module.__all__):
            thing = getattr(module, name)
            form = ""
            if inspect.isclass(thing) or inspect.isroutine(thing):
                try:
                    parameters = inspect.signature(thing).parameters.values()
                    form = f"({', '.join(_shown(each) for each in parameters)})"
                except (NameError, TypeError, ValueError):
                    form = "(…)"
            lines.append(f"{package}.{name}{form}\n")
    return "".join(lines)


def _shown(parameter):
    stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**", parameter.KEYWORD_ONLY: "*, "}
    default = "" if parameter.default is parameter.empty else "=…"
    return f"{stars.get(parameter.kind, '').replace('*, ', 'keyword ')}{parameter.name}{default}"


def test_public_names_change_on_purpose(generated, monkeypatch):
    """After a change on purpose `make public-names` writes the file anew, and the CHANGELOG tells of it."""
    import os

    found = public_names(generated)
    if os.environ.get("MDM_PUBLIC_NAMES") == "write":
        NAMES.write_text(found, encoding="utf-8")
    assert NAMES.read_text(encoding="utf-8") == found
