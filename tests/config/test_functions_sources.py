"""Functions are found in the source of their modules, and nothing of it is run."""

from __future__ import annotations

import inspect

import pytest

from mdm.config.functions import look_for
from mdm.errors import ConfigError
from mdm.runtime.handler import kind_of


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "machine.py").write_text(
        "raise SystemExit\nimport os.path\nfrom time import sleep as rest\n\ndef drive(): ...\n\nclass Arm:\n"
        "    def lift(self): ...\n\narm = Arm()\nif arm:\n    async def stop(): ...\n"
    )
    (tmp_path / "open.py").write_text("from machine import *\n")
    (tmp_path / "made.py").write_text("globals()['drive'] = print\n")
    (tmp_path / "broken.py").write_text("def drive(:\n")
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "__init__.py").write_text("")
    (tmp_path / "inner" / "wheels.py").write_text("def turn(): ...\n")
    return tmp_path


@pytest.mark.parametrize(
    "reference",
    [
        *("machine:drive", "machine:arm.lift", "machine:stop", "machine:rest", "machine:os.path.join"),
        *("open:whatever", "made:drive", "inner.wheels:turn", "builtins:print", "os.path:join", "sys:exit"),
    ],
)
def test_functions_that_there_seem_to_be(folder, reference):
    look_for(reference, folder)


KINDS = """
import asyncio, functools
raise SystemExit
async def go(): ...
def stop(now: undefined, /, how=undefined(), *rest, hard, soft=undefined, **more): ...
def each():
    yield 1
async def drips():
    async with asyncio.Lock():
        yield from_nowhere
def inner():
    def other():
        yield
    return lambda: (yield)
@functools.cache
def cached(a, b): ...
@decorated
async def wrapped(a, b): ...
@decorated
async def held():
    yield
def twice(): ...
def twice(a): ...
if twice:
    async def either(): ...
else:
    def either(): ...
async def late(): ...
late = functools.partial(late)
class Arm:
    async def lift(self): ...
"""


@pytest.mark.parametrize(
    ("name", "kind", "signature"),
    [
        ("go", "an async function", "()"),
        ("stop", None, "(now, /, how=None, *rest, hard, soft=None, **more)"),
        ("each", "a generator function", "()"),
        ("drips", "an async generator function", "()"),
        ("inner", None, "()"),
        ("wrapped", "an async function", "(*_, **__)"),
        ("late", "an async function", "(*_, **__)"),
    ],
)
def test_the_source_tells_the_kind_and_the_arguments_and_nothing_of_it_is_run(folder, name, kind, signature):
    (folder / "kinds.py").write_text(KINDS)
    seen = look_for(f"kinds:{name}", folder)
    assert (kind_of(seen), str(inspect.signature(seen))) == (kind, signature)
    assert (seen.__module__, seen.__qualname__) == ("kinds", name)


@pytest.mark.parametrize("name", ["cached", "held", "twice", "either", "Arm.lift", "functools.reduce", "Arm"])
def test_the_source_does_not_tell_all(folder, name):
    (folder / "kinds.py").write_text(KINDS)
    assert look_for(f"kinds:{name}", folder) is None


@pytest.mark.parametrize("name", ["time", "asyncio"])
def test_a_module_of_the_name_of_one_that_is_loaded_is_told(folder, name):
    (folder / f"{name}.py").write_text("def drive(): ...\n")
    with pytest.raises(ConfigError, match=f"another module '{name}' is already loaded, from .*: rename the one beside"):
        look_for(f"{name}:drive", folder)


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("machine:drve", "module 'machine' has no 'drve'; did you mean 'drive'"),
        ("machin:drive", "there is no module 'machin'; the file's folder is searched first"),
        ("inner.wheel:turn", "there is no module 'inner.wheel'"),
        ("broken:drive", "module 'broken' cannot be imported: SyntaxError"),
        ("drive", "must be given as 'module:name'"),
        ("robot.py:drive", "a module is given without its suffix: 'robot:drive'"),
    ],
)
def test_functions_that_there_are_not(folder, reference, words):
    with pytest.raises(ConfigError) as caught:
        look_for(reference, folder)
    assert words in str(caught.value)
