"""Functions that files name: found beside the file first, and never another module's."""

from __future__ import annotations

import asyncio
import os

import pytest
from loading import written
from robot_file import CALLBACKS, GOOD
from sentences import refused

from mdm import (
    ConfigError,
    load_system,
)
from mdm.config.functions import find_function, nothing


def test_a_module_of_the_same_name_from_another_folder_is_not_taken_for_this_one(folder, tmp_path_factory):
    load_system(written(folder, GOOD, "robot.toml"))
    other = tmp_path_factory.mktemp("other")
    (other / "robot_code.py").write_text(CALLBACKS)
    (other / "below.policy").write_text("[2](1,0)")
    with refused(ConfigError):
        load_system(written(other, GOOD, "robot.toml"))


def test_functions_are_found_beside_the_file_and_anywhere_else(folder):
    assert find_function("robot_code:rest", folder).__name__ == "rest"
    assert find_function("os.path:join", folder) is os.path.join
    assert find_function("os:path.join", folder) is os.path.join
    (folder / "package").mkdir()
    (folder / "package" / "__init__.py").write_text("def inside(): pass\n")
    assert find_function("package:inside", folder).__name__ == "inside"


def test_without_the_import_an_async_function_lasts_until_it_is_ended_and_a_plain_one_does_nothing(folder):
    system = load_system(written(folder, GOOD, "robot.toml"), callbacks=False)
    work, rest = (binding.function for binding in system.ensembles["below"].action.bindings)
    assert rest is nothing

    async def main():
        lasts = asyncio.ensure_future(work())
        await asyncio.sleep(0)
        assert not lasts.done()
        work.end()
        await lasts
        fails = asyncio.ensure_future(work())
        await asyncio.sleep(0)
        work.end(ValueError("no road"))
        with pytest.raises(ValueError, match="no road"):
            await fails

    asyncio.run(main())


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("rest", "a function must be given as 'module:name', not 'rest'"),
        ("robot_code.py:rest", "a module is given without its suffix: 'robot_code:rest'"),
        (":rest", "a function must be given as 'module:name'"),
        ("robot_code:", "a function must be given as 'module:name'"),
        ("robot_cod:rest", "there is no module 'robot_cod'; the file's folder is searched first"),
        ("robot_code:rst", "module 'robot_code' has no 'rst'; did you mean 'rest'"),
        ("robot_code:number", "'robot_code:number' is a int, not a function"),
        ("broken_code:x", "module 'broken_code' cannot be imported: ZeroDivisionError: division by zero"),
        ("leaving_code:x", "module 'leaving_code' cannot be imported: SystemExit: 3"),
        ("asking_code:x", "there is no module 'nowhere', which 'asking_code' imports"),
    ],
)
def test_what_is_no_function_is_told(folder, reference, words):
    (folder / "asking_code.py").write_text("import nowhere\n")
    with pytest.raises(ConfigError) as caught:
        find_function(reference, folder)
    assert words in str(caught.value)


def test_a_module_of_python_itself_is_not_taken_for_the_one_beside(folder):
    (folder / "sys.py").write_text("def path(): pass\n")
    with refused(ConfigError):
        find_function("sys:exit", folder)
