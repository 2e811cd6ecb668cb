"""Functions are found in the source of their modules, and nothing of it is run."""

from __future__ import annotations

import pytest

from mdm.config.sources import look_for
from mdm.errors import ConfigError


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


def test_async_functions_are_known_by_their_source(folder):
    (folder / "slow.py").write_text("async def go(): ...\ndef stop(): ...\nclass Arm:\n    async def lift(self): ...\n")
    assert [look_for(f"slow:{name}", folder) for name in ("go", "stop", "Arm.lift")] == [True, False, False]


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("machine:drve", "module 'machine' has no 'drve'; did you mean 'drive'"),
        ("machin:drive", "there is no module 'machin'; the file's folder is searched first"),
        ("inner.wheel:turn", "there is no module 'inner.wheel'"),
        ("broken:drive", "module 'broken' cannot be imported: SyntaxError"),
        ("drive", "must be given as 'module:name'"),
    ],
)
def test_functions_that_there_are_not(folder, reference, words):
    with pytest.raises(ConfigError) as caught:
        look_for(reference, folder)
    assert words in str(caught.value)
