"""The pages of the reference, against the code, both ways."""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import inspect
import re
import typing
from functools import cache
from pathlib import Path

import msgspec
import pytest
import values
from places import ROOT

import mdm
from mdm.cli import VERBS
from mdm.cli.projects.completion import commands

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


@cache
def text_of(path):
    return path.read_text(encoding="utf-8")


@cache
def parsed(path):
    return ast.parse(text_of(path))


def sources(words):
    """Return the modules of the package in which an expression is found, parsed."""
    return [(path, parsed(path)) for path in PACKAGE.rglob("*.py") if re.search(words, text_of(path))]


def test_every_public_name_is_documented(generated, pages):
    for package in generated.PACKAGES:
        module = importlib.import_module(package)
        page = pages[f"names-{package}.md"]
        assert re.findall(r"^## `(\w+)`$", page, re.MULTILINE) == sorted(module.__all__, key=str.lower)
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isclass(thing) or inspect.isroutine(thing):
                assert thing.__doc__.split("\n")[0].split("``")[0].split("`")[0] in page


def test_signatures_have_defaults_as_they_are_written_and_long_ones_a_line_for_each(pages):
    page = pages["names-mdm.simulation.building.md"]
    assert "    visits: Iterable[Visits] = (),\n    seed: int | None = None,\n    name: str = 'building',\n)\n" in page
    assert "    name: str,\n    *,\n    at: str | Pose | None,\n" in page
    lines = [line for block in page.split("```text\n")[1:] for line in block.split("```")[0].splitlines()]
    assert max(map(len, lines)) <= 100


def test_each_example_is_one_block_of_code(generated):
    """Names and indents of an example that an empty pair of lines divides were read as prose."""
    page = generated.names("mdm.policies")
    assert "    def action(self, state):\n        return state % 2\n\n\nmdm.Controller(Parity())" in page
    outside = "".join(page.split("```")[::2])
    assert "mdm.Controller(" not in outside


def test_every_package_with_public_names_has_its_page(generated):
    listed = {
        ".".join(("mdm", *path.parent.relative_to(PACKAGE).parts))
        for path in PACKAGE.rglob("__init__.py")
        if any(
            isinstance(node, ast.Assign) and node.targets[0].id == "__all__"
            for node in parsed(path).body
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
    assert structs == {*values.tables()}


def test_every_key_is_on_the_page_of_the_file(generated):
    page = (DOCS / "configuration.md").read_text(encoding="utf-8") + (DOCS / "communicating.md").read_text(
        encoding="utf-8"
    )
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
    reporting = re.compile("report|Fault|_alarm|_lose|refuse|Refusal|drop|call_soon")
    found = set()
    for path, tree in sources(reporting):
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
        for _, tree in sources("Statistics")
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and node.name.endswith("Statistics") and not node.name.startswith("_")
    }
    assert {path.rsplit(".", 1)[1] for path in generated.STATISTICS} == structs
    for path in generated.STATISTICS:
        struct = generated.find(path)
        part = pages["statistics.md"].split(f"## `{struct.__name__}`")[1].split("\n## ")[0]
        rows = re.findall(r"^\| `(\w+)` \| .+ \| (.*) \|$", part, re.MULTILINE)
        assert [field for field, _ in rows] == list(struct.__struct_fields__)
        assert [field for field, meaning in rows if not meaning.strip()] == [], path
        assert struct.__doc__.split("\n")[0].split("`")[0] in part


def channels():
    """Return the channels that the code makes: the last part of each name, the type, and whether it is retained."""
    found = set()
    for path, tree in sources(r"\bchannel\("):
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


def sent_between_agents():
    """Return the classes that are read from other agents, and the constant parts of the keys under which."""
    classes, keys = set(), set()
    for path, tree in sources(r"Decoder|\bkey\("):
        if not path.is_relative_to(PACKAGE / "team"):
            continue
        module = importlib.import_module(".".join(("mdm", *path.relative_to(PACKAGE).with_suffix("").parts)))
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            if name == "Decoder" and isinstance(call.args[0], ast.Name) and call.args[0].id != "type":
                kind = getattr(module, call.args[0].id)
                classes |= {each.__name__ for each in typing.get_args(kind) or (kind,)}
            elif name == "key" and ast.unparse(call.func.value).endswith(("link", "self")):
                parts = [
                    getattr(module, each.id, None) if isinstance(each, ast.Name) else getattr(each, "value", None)
                    for each in call.args
                ]
                keys.add(tuple(part for part in parts if isinstance(part, str)))
    return classes, keys


def test_every_message_between_agents_is_there(generated, pages):
    classes, keys = sent_between_agents()
    nested = {"Term", "Position", "Episode", "Experience"}  # within others
    assert {name for name in generated.bodies() if name not in nested} == classes
    assert set(re.findall(r"^### `(\w+)`$", pages["team-messages.md"], re.MULTILINE)) == set(generated.bodies())
    rows = [key for key, *_ in (*generated.SENT, *generated.ASKED)]
    told = {tuple(part for part in key.split("/") if part.islower() and part != "all") for key in rows}
    session = importlib.import_module("mdm.team.transport.session")
    assert {key for key in told if key[:1] != ("@team",)} == keys
    assert session._WHO in rows
    assert f"`{session._LIVE}/" in pages["team-messages.md"]


def test_messages_of_one_mode_are_those_that_its_layers_send(generated):
    sent = {key: {path.rsplit(".", 1)[1] for path in paths} for key, paths, *_ in generated.SENT}
    agreement = importlib.import_module("mdm.team.agreement.messages")
    both = sent["ENSEMBLE/agreement/all"] | sent["ENSEMBLE/agreement/AGENT"]
    assert both == {kind.__name__ for kind in typing.get_args(agreement.Message)}
    page = ast.parse((PACKAGE / "team" / "agreement" / "agreement.py").read_text(encoding="utf-8"))
    to_all = {
        call.args[1].func.id
        for call in ast.walk(page)
        if isinstance(call, ast.Call)
        and getattr(call.func, "attr", "") == "_send"
        and getattr(call.args[0], "value", "") is None
        and isinstance(call.args[1], ast.Call)
        and isinstance(call.args[1].func, ast.Name)
    }
    assert to_all
    assert to_all <= sent["ENSEMBLE/agreement/all"]


def anchors(text):
    """Return the anchors of a page's headings, as its host and the site make them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    plain = (re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading).strip().replace(" ", "-") for heading in plain}


def written(pages):
    """Return the texts of all pages, those that are made as the code has them now."""
    places = [
        *ROOT.glob("*.md"),
        *DOCS.rglob("*.md"),
        *(ROOT / "examples").rglob("*.md"),
        *ROOT.glob("benchmarks/*.md"),
    ]
    texts = {path: path.read_text(encoding="utf-8") for path in places if "_build" not in path.parts}
    return texts | {DOCS / "reference" / name: text for name, text in pages.items()}


def named(pages):
    """Yield every piece of code within the prose of a page, but for what once was and of benchmarks; the page first."""
    for path, text in written(pages).items():
        if path.name != "CHANGELOG.md" and path.parent.name != "benchmarks":
            prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
            yield from ((path.relative_to(ROOT).as_posix(), code) for code in re.findall(r"`([^`\n]+)`", prose))


@pytest.mark.skipif(not (ROOT / "CONTRIBUTING.md").is_file(), reason="beside the sources alone there are all pages")
def test_every_page_is_in_a_table_of_contents(pages):
    names = {str(path.relative_to(DOCS).with_suffix("")) for path in DOCS.rglob("*.md") if "_build" not in path.parts}
    names |= {f"reference/{page.removesuffix('.md')}" for page in pages}
    listed = {"index"}
    for name in names:
        page = DOCS / f"{name}.md"
        text = page.read_text(encoding="utf-8") if page.is_file() else ""
        for block in re.findall(r"^```\{toctree\}\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            entries = [line for line in block.splitlines() if line and not line.startswith(":")]
            listed |= {str((page.parent / entry).relative_to(DOCS)) for entry in entries}
    assert listed == names


def test_no_link_or_anchor_is_dead(pages):
    texts = written(pages)
    links, dead = 0, []
    for path, text in texts.items():
        prose = re.sub(r"```.*?```|``.*?``|`[^`\n]*`(?!\])", "", text, flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", prose):
            if re.match(r"[a-z]+:", link):
                continue
            links += 1
            name, _, anchor = link.partition("#")
            target = (path.parent / name).resolve() if name else path
            if not (target in texts or target.exists()) or (anchor and anchor not in anchors(texts[target])):
                dead.append((path.relative_to(ROOT).as_posix(), link))
    assert dead == []
    assert links > 150


def test_pages_name_no_verb_and_no_option_that_there_is_not(pages):
    known = list(commands())
    options = {name for command in known for names, *_ in command.options for name in names}
    options |= {"--fast", "--film", "--pixels", "--processor-limit"}  # of the demo, and of the tests
    verbs = {words for command in known for words in (command.words, *(f"{command.words} {v}" for v in command.verbs))}
    found = list(named(pages))
    told = {(page, option) for page, code in found for option in re.findall(r"(?<![\w-])--[a-z][\w-]*", code)}
    called = {(page, match[0]) for page, code in found if (match := re.match(r"mdm [a-z]+\d?(?:-\w+)*", code))}
    assert [each for each in told if each[1] not in options] == []
    assert [each for each in called if each[1] not in verbs] == []
    assert min(len(told), len(called)) > 50


def test_pages_name_nothing_of_the_package_that_there_is_not(pages):
    found = [(page, match[0]) for page, code in named(pages) if (match := re.match(r"mdm(?:\.[A-Za-z]\w*)+", code))]
    assert [each for each in found if not exists(each[1])] == []
    assert len(found) > 50


def exists(path):
    """Return whether a dotted path names a module, or something in one."""
    thing, name = importlib.import_module("mdm"), "mdm"
    for part in path.split(".")[1:]:
        name += f".{part}"
        if hasattr(thing, part):
            thing = getattr(thing, part)
        elif importlib.util.find_spec(name):
            thing = importlib.import_module(name)
        else:
            return False
    return True


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
                    form = f"({', '.join(_shown(each, generated.keywords(each)) for each in parameters)})"
                except (NameError, TypeError, ValueError):
                    form = "(…)"
            lines.append(f"{package}.{name}{form}\n")
    return "".join(lines)


def _shown(parameter, options):
    if options is not None:
        return ", ".join(f"keyword {name}=…" for name in options.__annotations__)
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
